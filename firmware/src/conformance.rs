//! The protocol's conformance tests on the target, in QEMU or on a board: runs the list, logs each verdict, and ends with an exit code.
#![no_std]
#![no_main]

use firmware::exit::{ExitCode, exit};

#[cortex_m_rt::entry]
fn main() -> ! {
    let (passed, failed) = protocol::conformance::run(|name, verdict| match verdict {
        Ok(()) => defmt::info!("test {=str} ... ok", name),
        Err(problem) => defmt::error!("test {=str} ... FAILED: {=str}", name, problem),
    });
    defmt::info!("{=u32} passed, {=u32} failed", passed, failed);
    exit(if failed == 0 { ExitCode::PowerOff } else { ExitCode::TestsFailed })
}
