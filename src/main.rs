//! The `veneer` command: parse, build, run, exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    veneer::cli::main()
}
