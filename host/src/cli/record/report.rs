//! The report of a recorded run.

use super::super::followed::Followed;
use super::super::output::Output;
use super::SessionArgs;
use crate::follow::Follower;
use device::record::Recorded;
use device::recording::RawFile;
use formats::session::{Session, sweeps_file};
use inference::holds::{HoldCriteria, UnusedPart, summary, unused};
use serde::Serialize;
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};

/// Result of a recording.
#[derive(Serialize)]
struct Report<'a> {
    schema: &'static str,
    session: &'a str,
    run: &'a str,
    #[serde(flatten)]
    recorded: Recorded,
    raw: Option<&'a RawFile>,
    /// The list of ultrasound frames, where there are some.
    frames: Option<PathBuf>,
    /// Holds, sweeps and points that no result will use.
    unused: Vec<UnusedPart>,
    /// Agreement of the force with a model, if one was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    followed: Option<Followed>,
}

impl Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Recorded {
            samples,
            duration_s,
            sweeps,
            samples_missing,
            samples_without_force,
            clock_steps,
            link,
        } = self.recorded;
        writeln!(
            f,
            "recorded   {} in {}: {samples} samples in {duration_s:.3} s, {sweeps} sweeps",
            self.run, self.session
        )?;
        if samples_missing == 0 && link == Default::default() {
            writeln!(f, "lost       nothing")?;
        } else {
            writeln!(
                f,
                "lost       {samples_missing} samples ({} frames missing, {} corrupt, {} unreadable)",
                link.frames_missing, link.frames_corrupt, link.frames_unreadable
            )?;
        }
        if samples_without_force > 0 {
            writeln!(f, "force      {samples_without_force} samples without a valid reading are left out")?;
        }
        if clock_steps > 0 {
            writeln!(
                f,
                "warning    the device's clock stepped back {clock_steps} times without a restart: what follows is a segment of its own, marked \
                 in the file, whose times go on from those before"
            )?;
        }
        if let Some(frames) = &self.frames {
            writeln!(f, "frames     {}: next, guide import ultrasound --run {}", frames.display(), self.run)?;
        }
        if let Some(raw) = self.raw {
            writeln!(f, "raw        {}: {} bytes", raw.path.display(), raw.bytes)?;
        }
        if let Some(followed) = &self.followed {
            write!(f, "{followed}")?;
        }
        for line in summary(&self.unused) {
            writeln!(f, "warning    {line}")?;
        }
        Ok(())
    }
}

/// Prints the report of a run.
pub(super) fn print(
    schema: &'static str,
    args: &SessionArgs,
    id: &str,
    recorded: Recorded,
    raw: Option<&RawFile>,
    follower: Option<Follower>,
    out: &mut Output,
) -> anyhow::Result<()> {
    let session = args.out.to_string_lossy();
    let frames = Some(sweeps_file(&args.out, id)).filter(|file| file.exists());
    let report = Report {
        schema,
        session: &session,
        run: id,
        recorded,
        raw,
        frames,
        unused: unused_of(&args.out, id),
        followed: follower.map(Followed::from),
    };
    out.result(&report, &report)
}

/// Rows of a run that no result will use. If another run makes the session unreadable there is no remark here: `guide
/// check` does.
fn unused_of(dir: &Path, id: &str) -> Vec<UnusedPart> {
    let Ok(session) = Session::read(dir) else { return Vec::new() };
    let run = session.lateral.iter().find(|run| run.id == id);
    run.map_or_else(Vec::new, |run| unused(run, &session.rig, &HoldCriteria::default()))
}
