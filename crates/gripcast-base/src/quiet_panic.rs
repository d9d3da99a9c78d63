//! Panics of a library as values.
//!
//! The ONNX engine and the Parquet decoders panic on some contents that no exporter writes but a
//! damaged file can hold. Such a panic is an explained refusal to the user, so neither the process
//! nor the screen may see it.

use std::any::Any;
use std::cell::Cell;
use std::panic::{self, UnwindSafe};
use std::sync::Once;

thread_local! {
    static QUIET: Cell<bool> = const { Cell::new(false) };
}

/// Runs `work`; a panic in it is returned as its message and prints nothing.
///
/// # Errors
/// The message of the panic.
pub fn catch<T>(work: impl FnOnce() -> T + UnwindSafe) -> Result<T, String> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let previous = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !QUIET.get() {
                previous(info);
            }
        }));
    });
    let outer = QUIET.replace(true);
    let result = panic::catch_unwind(work);
    QUIET.set(outer);
    result.map_err(|payload| message(payload.as_ref()))
}

fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| payload.downcast_ref::<String>().map(String::as_str));
    text.unwrap_or("no message").to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_its_message_and_others_pass() {
        let index = std::hint::black_box(4);
        let caught = catch(|| [0_u8; 3][index]).unwrap_err();
        assert!(caught.contains("index out of bounds"), "{caught}");
        assert_eq!(catch(|| 7), Ok(7));
        assert!(!QUIET.get());
    }
}
