//! The program `guide`: everything is in [`host::cli`].
#![forbid(unsafe_code)]
#![deny(missing_docs)]

fn main() -> std::process::ExitCode {
    // The shells of Windows leave `sessions\\*` to the programs.
    host::cli::main(wild::args_os())
}
