//! The fake device as a program, for clients in other languages: prints the name of its port, then, for every line on standard input,
//! what it has carried out since the line before, and ends with standard input.
//!
//! Its program holds for `SECONDS` (first argument; 0: one batch; second argument: a TCP address in place of a pseudo terminal), and ends by the fault of a silent host where no command comes for
//! half a second of its clock.
#![forbid(unsafe_code)]

use fake_device::{Act, FakeDevice, Script};
use std::io::{BufRead, Write};

fn main() -> std::io::Result<()> {
    const BATCH: u64 = 32;
    let seconds: u64 = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(0);
    let cycles = seconds * 1_000 / BATCH;
    let hold_acts = (0..cycles).flat_map(|_| [Act::Batch(BATCH as usize), Act::Wait(BATCH)]);
    let program =
        std::iter::once(Act::Batch(BATCH as usize)).chain(hold_acts).chain([Act::Complete]).collect();
    let script = Script { silence_limit_ms: 500, program, ..Script::default() };
    let device = match std::env::args().nth(2) {
        Some(address) => FakeDevice::start_at(&address, script),
        None => FakeDevice::start(script),
    };
    let mut output = std::io::stdout();
    writeln!(output, "{}", device.port)?;
    output.flush()?;
    let mut reported = 0;
    for line in std::io::stdin().lock().lines() {
        line?;
        let executed = device.executed();
        let names = executed.iter().skip(reported).map(|request| format!("{request:?}"));
        writeln!(output, "{}", names.collect::<Vec<_>>().join("; "))?;
        output.flush()?;
        reported = executed.len();
    }
    Ok(())
}
