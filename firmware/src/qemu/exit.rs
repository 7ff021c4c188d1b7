//! How the program ends in QEMU.

/// How a run ended: QEMU's exit code.
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
    /// The program touched something that is not modelled, or faulted.
    Fault = 5,
    /// The program panicked.
    Panic = 101,
}

/// Ends QEMU.
pub fn exit(code: ExitCode) -> ! {
    semihosting::process::exit(code as i32)
}
