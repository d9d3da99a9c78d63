//! Catches panics of third-party libraries.
//!
//! The ONNX engine and the Parquet decoders panic on some damaged files. The caller turns such a
//! panic into an error, so it must neither end the process nor print to the screen.

use std::any::Any;
use std::cell::Cell;
use std::panic::{self, UnwindSafe};
use std::sync::Once;

thread_local! {
    static QUIET: Cell<bool> = const { Cell::new(false) };
}

/// Runs `work`; returns the message of a panic without printing it.
///
/// # Errors
/// The message of the panic.
pub fn catch_panic<T>(work: impl FnOnce() -> T + UnwindSafe) -> Result<T, String> {
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
    fn panic_becomes_its_message() {
        let index = std::hint::black_box(4);
        let caught = catch_panic(|| [0_u8; 3][index]).unwrap_err();
        assert!(caught.contains("index out of bounds"), "{caught}");
        assert_eq!(catch_panic(|| 7), Ok(7));
        assert!(!QUIET.get());
    }
}
