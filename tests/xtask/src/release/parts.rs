//! Common content of the bundles for all systems: page, firmware, manual.

use super::systems::copy;
use super::{Release, tools};
use crate::build::{cargo_with, image_parts, root, target_dir};
use crate::licences::{self, Built};
use crate::{check, setup, web};
use anyhow::Result;
use std::fs;
use std::path::PathBuf;

/// Boards, by the firmware's features.
const BOARDS: [&str; 2] = ["b-l475e-iot01a", "nucleo-l476rg"];

/// The page, and the licences of the project.
///
/// # Errors
/// Where it cannot be built.
pub fn page(release: &Release) -> Result<PathBuf> {
    let page = web::make(&release.flags(web::TARGET, &[])?)?;
    let files = release.stage.join("files");
    copy(&page, &files.join("guide.html"))?;
    for name in ["LICENSE-MIT", "LICENSE-APACHE"] {
        copy(&root().join(name), &files.join(name))?;
    }
    let licences = licences::collect(&Built { package: "web", features: "", target: web::TARGET })?;
    fs::write(release.stage.join("licences/guide.html.txt"), licences.lines())?;
    Ok(page)
}

/// The images of both boards.
///
/// # Errors
/// Where one cannot be built.
pub fn firmware(release: &Release) -> Result<()> {
    setup::ensure_target()?;
    let stage = release.stage.join("firmware");
    fs::create_dir_all(&stage)?;
    let flags = release.flags(setup::TARGET, &[])?;
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    for board in BOARDS {
        eprintln!("xtask: firmware of {board}");
        let folder = target_dir().join(format!("image-release-{board}"));
        let features = format!("flash,{board}");
        let image = ["image", "--locked", "--bin", "firmware", "--features", &features, "--target-dir"];
        let parts_dir = image_parts();
        cargo_with(
            &[&image[..], &[&*folder.to_string_lossy()], &flags].concat(),
            &[("CARGO_BUILD_BUILD_DIR", &parts_dir.to_string_lossy())],
        )?;
        copy(&folder.join(setup::TARGET).join("firmware/firmware"), &stage.join(format!("{board}.elf")))?;
        let licences =
            licences::collect(&Built { package: "firmware", features: &features, target: setup::TARGET })?;
        fs::write(release.stage.join("licences").join(format!("firmware {board}.txt")), licences.lines())?;
    }
    Ok(())
}

/// The manual as a site, with the page in it, whose views take the place of figures.
///
/// # Errors
/// Where mdBook cannot be installed, or warns.
pub fn manual(release: &Release) -> Result<()> {
    let mdbook = tools::mdbook(release)?;
    let stage = release.stage.join("manual");
    check::book(&mdbook, &stage)?;
    copy(&release.stage.join("files/guide.html"), &stage.join("guide.html"))
}
