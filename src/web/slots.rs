//! Limited connection slots, separate for TCP and the Unix socket, so that a flood of one does not
//! block the other.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::access::Peer;

/// Limited slots; clones share them.
#[derive(Clone, Debug)]
pub(crate) struct Slots {
    pub(super) network: Arc<Semaphore>,
    pub(super) local: Arc<Semaphore>,
}

impl Slots {
    /// Creates slots for TCP and for the Unix socket.
    pub(super) fn new(network: usize, local: usize) -> Self {
        Self {
            network: Arc::new(Semaphore::new(network)),
            local: Arc::new(Semaphore::new(local)),
        }
    }

    /// Takes a slot until the permit is dropped; `None` if all are in use.
    pub(super) fn take(&self, peer: Peer) -> Option<OwnedSemaphorePermit> {
        let slots = match peer {
            Peer::Network(_) => &self.network,
            Peer::Local => &self.local,
        };
        Arc::clone(slots).try_acquire_owned().ok()
    }
}
