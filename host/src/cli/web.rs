//! `guide web`: the page `guide.html` on loopback, with the sessions of a folder and the device live.

use super::followed::FollowArgs;
use super::output::Output;
use super::rig_args::interrupted;
use crate::follow::{Follower, push, sentence_now};
use anyhow::{Context, bail};
use device::link::{Batch, Client, Program};
use serde::Serialize;
use server::sessions::Sessions;
use server::{Live, Page, ServedContent, Server};
use std::collections::BTreeSet;
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Name of the page.
const PAGE: &str = "guide.html";
/// Interval at which the program checks whether it is to end.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// The built-in programs.
const BUILT_IN: [&str; 3] = ["displace", "staircase", "quick-staircase"];

/// Serve the page guide.html on this machine: the sessions below a folder in a browser, and the device live
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide web\n  guide web measurements --port /dev/ttyACM0\n  guide web measurements --port /dev/ttyACM0 --follow model.toml --rig rig.toml \
                        --depth-mm 30"
)]
pub struct Args {
    /// Folder whose sessions the page can open; files are read only
    #[arg(default_value = ".")]
    dir: PathBuf,
    /// Serial port of the device: the page shows it live, and one page at a time can move it
    #[arg(long, value_name = "PORT")]
    port: Option<String>,
    /// Motion program that the page can run, in addition to the built-in ones: may be given more than once
    #[arg(long, value_name = "FILE", requires = "port")]
    program: Vec<String>,
    #[command(flatten)]
    follow: FollowArgs,
    /// The page (default: guide.html in the program's folder; else target/web/guide.html of the checkout that the program was built in)
    #[arg(long, value_name = "FILE")]
    page: Option<PathBuf>,
    /// Port of the page's address (default: a free one)
    #[arg(long, value_name = "PORT", value_parser = clap::value_parser!(u16).range(1..))]
    http_port: Option<u16>,
    /// Duration, seconds (default: until interrupted)
    #[arg(long, value_name = "SECONDS", value_parser = super::record::duration_s)]
    duration_s: Option<f64>,
}

#[derive(Serialize)]
struct Report<'a> {
    schema: &'static str,
    dir: &'a Path,
    address: String,
    port: Option<&'a str>,
}

impl Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "sessions   {}", self.dir.display())?;
        if let Some(port) = self.port {
            writeln!(f, "device     {port}")?;
        }
        writeln!(f, "open       {}", self.address)
    }
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let interrupted = interrupted()?;
    let follower = args.follow.follower()?;
    let program =
        std::env::current_exe().and_then(std::fs::canonicalize).context("cannot find the program")?;
    let sessions = Sessions::of(&args.dir).with_context(|| format!("{}: cannot open", args.dir.display()))?;
    let page = Page::read(&page_file(args.page.as_deref(), &program)?)?;
    let mut live = args.port.as_deref().map(|port| follow(port, &args.program, follower)).transpose()?;
    let feed = live.as_ref().map(Live::feed);
    let port = args.http_port.unwrap_or_default();
    let server = Server::start(ServedContent { page, sessions, feed }, port)
        .with_context(|| format!("cannot serve at 127.0.0.1:{port}"))?;
    let port = args.port.as_deref();
    let report = Report { schema: "guide.web/1", dir: &args.dir, address: server.url(), port };
    out.line(&report, &report)?;

    let began = Instant::now();
    while !interrupted.load(Ordering::Acquire) && !is_over(&began, args.duration_s) {
        if !server.is_running() {
            bail!("the server's thread has ended");
        }
        match &mut live {
            Some(live) if !live.is_running() => bail!("the link's thread has ended"),
            Some(live) => live.supervise(POLL_INTERVAL),
            None => std::thread::sleep(POLL_INTERVAL),
        }
    }
    Ok(())
}

fn is_over(began: &Instant, duration_s: Option<f64>) -> bool {
    duration_s.is_some_and(|limit_s| began.elapsed().as_secs_f64() > limit_s)
}

/// The device under supervision, with the programs that pages can run.
fn follow(port: &str, files: &[String], mut follower: Option<Follower>) -> anyhow::Result<Live> {
    let names = BUILT_IN.into_iter().chain(files.iter().map(String::as_str));
    let programs = names.map(Program::load).collect::<Result<Vec<_>, _>>()?;
    let mut titles = BTreeSet::new();
    if let Some(again) = programs.iter().find(|program| !titles.insert(&program.name)) {
        bail!("two programs are named `{}`, expected another name in one of the files", again.name);
    }
    let compare = move |batch: &Batch| {
        let departures = follower.as_mut().map(|follower| push(follower, &batch.points)).unwrap_or_default();
        departures.iter().map(sentence_now).collect()
    };
    Live::start(Client::connect(port)?, programs, compare).context("cannot start the link's thread")
}

/// File of the page: as stated; else beside the program; else where `cargo xtask web` puts it, beside the folder of the
/// build.
fn page_file(stated: Option<&Path>, program: &Path) -> anyhow::Result<PathBuf> {
    if let Some(stated) = stated {
        return Ok(stated.to_owned());
    }
    let folder = program.parent().unwrap_or(Path::new("."));
    let sibling = folder.join(PAGE);
    let built = folder.parent().map(|target| target.join("web").join(PAGE));
    let candidates = [Some(sibling), built];
    match candidates.iter().flatten().find(|place| place.is_file()) {
        Some(found) => Ok(found.clone()),
        None => bail!(
            "there is no {PAGE} beside the program ({}); make it with `cargo xtask web` in a checkout of the source and put it there, or name it with --page",
            folder.display()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_beside_the_program_comes_before_the_one_of_the_build() {
        let folder = tempfile::tempdir().expect("a folder");
        let (debug, web) = (folder.path().join("debug"), folder.path().join("web"));
        std::fs::create_dir_all(&debug).expect("a folder");
        std::fs::create_dir_all(&web).expect("a folder");
        let program = debug.join("guide");
        let error = page_file(None, &program).expect_err("there is none").to_string();
        assert!(error.contains("cargo xtask web") && error.contains("--page"), "{error}");
        std::fs::write(web.join(PAGE), "built").expect("a file");
        assert_eq!(page_file(None, &program).expect("built"), web.join(PAGE));
        std::fs::write(debug.join(PAGE), "beside").expect("a file");
        assert_eq!(page_file(None, &program).expect("beside"), debug.join(PAGE));
        let stated = Path::new("elsewhere.html");
        assert_eq!(page_file(Some(stated), &program).expect("stated"), stated);
    }
}
