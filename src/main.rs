//! `gripcast`: see `gripcast --help`.

use std::process::ExitCode;

fn main() -> ExitCode {
    gripcast::cli::main()
}
