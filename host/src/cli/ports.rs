//! `guide ports`: which serial ports there are, and which of them is the device.

use super::output::Output;
use anyhow::Context;
use device::link::port::{self, PortInfo};
use device::link::{Client, LinkError};
use serde::Serialize;
use std::fmt::{self, Display};

/// Hellos sent to each port: a device answers the first.
const TRIES: u32 = 2;

/// List serial ports and mark those that answer the handshake
#[derive(clap::Args)]
#[command(after_help = "Example:\n  guide ports\n  guide ports /dev/pts/4")]
pub struct Args {
    /// Ports to try (default: all that the system lists)
    #[arg(value_name = "PORT")]
    ports: Vec<String>,
}

#[derive(Serialize)]
struct Ports {
    schema: &'static str,
    ports: Vec<Entry>,
}

#[derive(Serialize)]
struct Entry {
    port: String,
    description: String,
    device: Option<Device>,
    problem: Option<String>,
}

#[derive(Serialize)]
struct Device {
    board: String,
    firmware_version: String,
    commit: String,
    protocol_version: u16,
    boot_id: u32,
    calibration_id: String,
    calibration_crc: String,
}

impl Display for Ports {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.ports.is_empty() {
            return writeln!(f, "no serial ports");
        }
        for Entry { port, description, device, problem } in &self.ports {
            match (device, problem) {
                (Some(device), _) => writeln!(
                    f,
                    "* {port}  needle guide on {}, firmware {} ({}), calibration {} ({})  {description}",
                    device.board,
                    device.firmware_version,
                    device.commit,
                    device.calibration_id,
                    device.calibration_crc
                )?,
                (None, Some(problem)) => writeln!(f, "  {port}  {problem}  {description}")?,
                (None, None) => writeln!(f, "  {port}  {description}")?,
            }
        }
        Ok(())
    }
}

/// Runs `guide ports`.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let listed = if args.ports.is_empty() {
        port::list().context("cannot list the serial ports")?
    } else {
        args.ports.iter().map(|name| PortInfo { name: name.clone(), description: String::new() }).collect()
    };
    let ports = Ports { schema: "guide.ports/1", ports: listed.into_iter().map(look).collect() };
    out.result(&ports, &ports)
}

fn look(listed: PortInfo) -> Entry {
    let PortInfo { name: port, description } = listed;
    let (device, problem) = match Client::connect_within(&port, TRIES) {
        Ok(client) => {
            let hello = client.hello();
            let device = Device {
                board: hello.board.as_str().to_owned(),
                firmware_version: hello.firmware_version.as_str().to_owned(),
                commit: hello.commit.as_str().to_owned(),
                protocol_version: hello.protocol_version,
                boot_id: client.boot_id(),
                calibration_id: hello.calibration.id.as_str().to_owned(),
                calibration_crc: format!("{:08x}", hello.calibration.crc),
            };
            (Some(device), None)
        }
        // Most ports are something else; that is no problem to report.
        Err(LinkError::NoAnswer { .. }) => (None, None),
        Err(error) => (None, Some(error.to_string())),
    };
    Entry { port, description, device, problem }
}
