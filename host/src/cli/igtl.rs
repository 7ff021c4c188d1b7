//! Common parts of the sub-commands that use OpenIGTLink: a tracker as the ultrasound, and publishing what is
//! measured.

use super::import_shapes::{millimetres, vector};
use super::output::Output;
use crate::igtl::live::USUAL_RATE_HZ;
use crate::igtl::{Live, Scene};
use anyhow::Context;
use device::igtl::channel::{Channel, DELAY_RANGE_S, Settings, TIP_DEVICE_NAME};
use device::igtl::server::ClientChange;
use device::igtl::{Publisher, server};
use formats::model_file::ModelFile;
use formats::session::Session;
use formats::session::import::Frame;
use inference::identify::{self, identify};
use mechanics::{Model, Rig};
use std::net::SocketAddr;
use std::path::Path;

/// A tracker that measures where the needle is.
#[derive(clap::Args)]
#[command(next_help_heading = "Tracker over OpenIGTLink")]
pub struct TrackerArgs {
    /// Take shape and tip of the needle from this OpenIGTLink server (tracker, PLUS, 3D Slicer; port 18944 unless
    /// given) instead of the ultrasound, synchronised with the device
    #[arg(long, value_name = "HOST")]
    igtl: Option<String>,
    /// Device name of the POINT messages that are the needle's shape (default: any)
    #[arg(long, value_name = "NAME", requires = "igtl")]
    igtl_shape: Option<String>,
    /// Device name of the TRANSFORM or POSITION messages that are the needle's tip
    #[arg(long, value_name = "NAME", requires = "igtl", default_value = TIP_DEVICE_NAME)]
    igtl_tip: String,
    /// Delay from the tracker's measurement to the time stamp of its message, seconds
    #[arg(long, value_name = "SECONDS", requires = "igtl", default_value_t = 0.0, value_parser = delay_s)]
    igtl_delay_s: f64,
    /// A point of the straight needle in the tracker's coordinates, millimetres
    #[arg(long, value_name = "X,Y,Z", requires = "igtl", value_parser = vector, allow_hyphen_values = true, default_value = "0,0,0")]
    origin_mm: [f64; 3],
    /// Position of that point along the needle from guide 1, millimetres
    #[arg(long, value_name = "MM", requires = "igtl", value_parser = millimetres, default_value_t = 0.0)]
    origin_z_mm: f64,
    /// Direction of the straight needle into the tissue, in the tracker's coordinates
    #[arg(long, value_name = "X,Y,Z", requires = "igtl", value_parser = vector, allow_hyphen_values = true, default_value = "0,0,1")]
    axis: [f64; 3],
    /// Direction that is up, the session's y, in the tracker's coordinates
    #[arg(long, value_name = "X,Y,Z", requires = "igtl", value_parser = vector, allow_hyphen_values = true, default_value = "0,1,0")]
    up: [f64; 3],
}

fn delay_s(text: &str) -> Result<f64, String> {
    let [least, most] = DELAY_RANGE_S;
    let value = text.parse().ok().filter(|value| (least..=most).contains(value));
    value.ok_or_else(|| format!("expected a number from {least} to {most}"))
}

impl TrackerArgs {
    /// Connects, where a tracker is named.
    pub fn connect(&self) -> anyhow::Result<Option<Channel>> {
        let Some(address) = &self.igtl else { return Ok(None) };
        let frame =
            Frame::given(self.origin_mm.map(|mm| 1e-3 * mm), 1e-3 * self.origin_z_mm, self.axis, self.up)?;
        let settings = Settings {
            shape: self.igtl_shape.clone(),
            tip: self.igtl_tip.clone(),
            delay_s: self.igtl_delay_s,
            frame,
        };
        Ok(Some(Channel::connect(address, settings)?))
    }
}

/// Rate at which clients receive the device's values.
#[derive(clap::Args)]
pub struct RateArgs {
    /// Updates for OpenIGTLink clients per second of the device's clock
    #[arg(long, value_name = "HZ", default_value_t = USUAL_RATE_HZ, value_parser = rate_hz)]
    rate_hz: f64,
    /// OpenIGTLink clients at a time; more are rejected
    #[arg(long, value_name = "N", default_value_t = server::MAX_CLIENTS, value_parser = max_clients)]
    max_clients: usize,
}

fn max_clients(text: &str) -> Result<usize, String> {
    let value = text.parse().ok().filter(|value| (1..=server::MAX_CLIENTS).contains(value));
    value.ok_or_else(|| format!("expected a number from 1 to {}", server::MAX_CLIENTS))
}

/// A change of a client, as a remark.
fn client_remark((address, change): (SocketAddr, ClientChange), max_clients: usize) -> String {
    match change {
        ClientChange::Connected => format!("OpenIGTLink client {address} connected"),
        ClientChange::Left => format!("OpenIGTLink client {address} disconnected"),
        ClientChange::Rejected => {
            format!("OpenIGTLink client {address} rejected: {max_clients} are connected (--max-clients)")
        }
    }
}

fn rate_hz(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value| (0.1..=1000.0).contains(value));
    value.ok_or_else(|| "expected a number from 0.1 to 1000".to_owned())
}

impl RateArgs {
    /// Remarks on who has connected to a server and left it since the last call.
    pub fn client_remarks(&self, live: &Live) -> Vec<String> {
        let changes = live.publisher().client_changes().into_iter();
        changes.map(|change| client_remark(change, self.max_clients)).collect()
    }

    /// A server there.
    pub fn serve(&self, address: &str, scene: Scene) -> anyhow::Result<Live> {
        let publisher = Publisher::bind(server::address(address)?, self.max_clients)?;
        Ok(Live::new(publisher, scene, self.rate_hz))
    }
}

/// Publishing beside what else is done.
#[derive(clap::Args)]
#[command(next_help_heading = "Publishing over OpenIGTLink")]
pub struct PublishArgs {
    /// Publish guide, force and sweeps over OpenIGTLink meanwhile, as `guide serve --igtl` does, and tip and shape where the session
    /// gives the modulus already; to this machine alone unless an address is given
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, require_equals = true, default_missing_value = USUAL)]
    publish: Option<String>,
    #[command(flatten)]
    rate: RateArgs,
}

/// Address at which clients on this machine look for a server.
pub const USUAL: &str = "127.0.0.1:18944";

impl PublishArgs {
    /// Begins to publish, where that is wanted.
    pub fn begin(&self, rig: &Rig, dir: &Path, depth_mm: f64, out: &Output) -> anyhow::Result<Option<Live>> {
        let Some(address) = &self.publish else { return Ok(None) };
        let mut live = self.rate.serve(address, Scene::new(rig.guide2_m, rig.entry_m))?;
        out.note(format_args!("OpenIGTLink at {}", live.publisher().address()));
        match Session::read(dir).ok().as_ref().and_then(modulus_pa) {
            Some(modulus_pa) => set_tissue_model(live.scene(), rig, modulus_pa, None, depth_mm)?,
            None => out.note(
                "tip and shape of the needle are not published: the session does not give the modulus yet",
            ),
        }
        Ok(Some(live))
    }
}

/// Modulus of the tissue as the session's lateral runs have it.
fn modulus_pa(session: &Session) -> Option<f64> {
    let identification = identify(session, &identify::Options::default()).ok();
    identification.map(|identification| 1e3 * identification.pooled.k_kpa)
}

/// Has tip and shape published.
pub fn set_tissue_model(
    scene: &mut Scene,
    rig: &Rig,
    modulus_pa: f64,
    model: Option<&ModelFile>,
    depth_mm: f64,
) -> anyhow::Result<()> {
    let mut model_of_tissue = Model::uniform(rig.clone(), modulus_pa)?;
    model_of_tissue.effects = model.map(ModelFile::effects).unwrap_or_default();
    scene.tissue(&model_of_tissue, 1e-3 * depth_mm).context("cannot solve the needle")
}
