//! The engine as a program: one request on standard input, the answer on standard output, steps of slow computations on standard error.
//!
//! In the browser the page calls its entry point once per request; between calls the engine keeps what it has prepared.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

use std::cell::RefCell;
use std::io::{self, Read, Write};
use std::process::ExitCode;
use web::Engine;

thread_local! {
    static ENGINE: RefCell<Engine> = RefCell::default();
}

fn main() -> ExitCode {
    let mut request = String::new();
    if let Err(error) = io::stdin().read_to_string(&mut request) {
        eprintln!("error: cannot read the request: {error}");
        return ExitCode::FAILURE;
    }
    let answer = ENGINE.with_borrow_mut(|engine| engine.answer(&request, |step| eprintln!("{step}")));
    match writeln!(io::stdout(), "{answer}") {
        Ok(()) => ExitCode::SUCCESS,
        Err(_) => ExitCode::FAILURE,
    }
}
