//! Slots that are limited, apart for TCP and for the Unix socket: who floods the one never locks
//! out the other.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::access::Peer;

/// Slots; a clone fractions them.
#[derive(Clone, Debug)]
pub(crate) struct Slots {
    pub(super) network: Arc<Semaphore>,
    pub(super) local: Arc<Semaphore>,
}

impl Slots {
    /// That many over TCP and over the Unix socket.
    pub(super) fn new(network: usize, local: usize) -> Self {
        Self {
            network: Arc::new(Semaphore::new(network)),
            local: Arc::new(Semaphore::new(local)),
        }
    }

    /// A place until it is dropped, if one is free.
    pub(super) fn take(&self, peer: Peer) -> Option<OwnedSemaphorePermit> {
        let places = match peer {
            Peer::Network(_) => &self.network,
            Peer::Local => &self.local,
        };
        Arc::clone(places).try_acquire_owned().ok()
    }
}
