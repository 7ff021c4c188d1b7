//! Measures run times of the guide's programs, beside those of alternative libraries, and how they scale; writes the page of them.
//! `cargo xtask bench` runs it.
#![forbid(unsafe_code)]

mod clock;
mod estimators;
mod link;
mod machine;
mod forward;
mod page;
mod python;
mod rows;
mod scaling;
mod session;
mod wire;

use anyhow::{Context, Result};
use clock::Clock;
use page::Page;
use std::path::PathBuf;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let cache = PathBuf::from(arguments.next().context("usage: beside CACHE PAGE [SEED]")?);
    let page = PathBuf::from(arguments.next().context("usage: beside CACHE PAGE [SEED]")?);
    let seed = arguments.next().map_or(Ok(1), |seed| seed.parse())?;
    std::fs::create_dir_all(&cache)?;
    let mut clock = Clock::new(&cache.join("criterion"));
    let machine = machine::Machine::new(&mut clock)?;
    let scripts = concat!(env!("CARGO_MANIFEST_DIR"), "/../peers");
    let python = python::Python::new(scripts.as_ref(), &cache);
    if let Err(why) = &python {
        println!("peers in Python are skipped: {why:#}");
    }
    let python = python.ok();
    let wire = wire::measure(&mut clock, seed)?;
    let rows = rows::measure(&mut clock, python.as_ref(), &machine, &cache, seed.into())?;
    let scaling = scaling::measure(&mut clock, &cache)?;
    let version = python.map(|python| python.version()).transpose()?;
    let text = Page { machine: &machine, python: version, seed, wire: &wire, rows: &rows, scaling: &scaling }
        .text()?;
    std::fs::write(&page, text).with_context(|| page.display().to_string())?;
    println!("wrote {}", page.display());
    Ok(())
}
