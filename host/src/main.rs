//! The program `guide`: everything is in [`host::cli`].
#![forbid(unsafe_code)]
#![deny(missing_docs)]

fn main() -> std::process::ExitCode {
    host::cli::main(std::env::args_os())
}
