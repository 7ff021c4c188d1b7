//! Ends a program with an exit code over semihosting, with which QEMU and `probe-rs run` then exit.

/// Outcome of a run: the exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExitCode {
    /// The plant requested power-off, or all tests passed.
    PowerOff = 0,
    /// A test failed.
    TestsFailed = 1,
    /// The plant closed its pipes, or they cannot be opened.
    PlantGone = 3,
    /// The plant sent something that is no reply to the request.
    PlantRecord = 4,
    /// The program accessed a register that is not modelled, or faulted.
    Fault = 5,
    /// The program panicked.
    Panic = 101,
}

/// Ends the run.
pub fn exit(code: ExitCode) -> ! {
    // Time for the probe to fetch the log: half a second at the clock that the core starts with.
    #[cfg(not(feature = "qemu"))]
    cortex_m::asm::delay(2_000_000);
    semihosting::process::exit(code as i32)
}
