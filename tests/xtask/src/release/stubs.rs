//! Names of the functions that the program for macOS takes from the system's frameworks: what a linker needs of them where there is no macOS.
//!
//! A name that is missing here is an error of the linker. macOS itself has the functions.

use anyhow::{Context, Result};
use std::fs;
use std::path::Path;

/// A library of the system, its place there, and what is used of it.
const LIBRARIES: [(&str, &str, &[&str]); 3] = [
    (
        "CoreFoundation.framework/CoreFoundation.tbd",
        "/System/Library/Frameworks/CoreFoundation.framework/Versions/A/CoreFoundation",
        &[
            "_CFDictionaryCreateMutable",
            "_CFDictionaryGetValueIfPresent",
            "_CFDictionarySetValue",
            "_CFGetTypeID",
            "_CFNumberGetTypeID",
            "_CFNumberGetValue",
            "_CFRelease",
            "_CFRetain",
            "_CFStringCreateWithBytes",
            "_CFStringCreateWithBytesNoCopy",
            "_CFStringCreateWithCString",
            "_CFStringGetBytes",
            "_CFStringGetCString",
            "_CFStringGetCStringPtr",
            "_CFStringGetLength",
            "_CFStringGetTypeID",
            "_kCFAllocatorDefault",
            "_kCFAllocatorNull",
            "_kCFBooleanTrue",
            "_kCFTypeDictionaryKeyCallBacks",
            "_kCFTypeDictionaryValueCallBacks",
        ],
    ),
    (
        "IOKit.framework/IOKit.tbd",
        "/System/Library/Frameworks/IOKit.framework/Versions/A/IOKit",
        &[
            "_IOIteratorNext",
            "_IOMasterPort",
            "_IOObjectConformsTo",
            "_IOObjectGetClass",
            "_IOObjectRelease",
            "_IORegistryEntryCreateCFProperties",
            "_IORegistryEntryCreateCFProperty",
            "_IORegistryEntryGetParentEntry",
            "_IOServiceGetMatchingServices",
            "_IOServiceMatching",
        ],
    ),
    ("libobjc.tbd", "/usr/lib/libobjc.A.dylib", &["_objc_autorelease", "_objc_release", "_objc_retain"]),
];

/// Writes the stubs below a folder; options of the linker that have it look there.
///
/// # Errors
/// Where a file cannot be written.
pub fn written(folder: &Path) -> Result<Vec<String>> {
    for (file, install_name, symbols) in LIBRARIES {
        let path = folder.join(file);
        let cannot = || format!("{}: cannot write", path.display());
        fs::create_dir_all(path.parent().unwrap_or(folder)).with_context(cannot)?;
        fs::write(&path, stub(install_name, symbols)).with_context(cannot)?;
    }
    let folder = std::path::absolute(folder)?;
    Ok(vec![format!("-F{}", folder.display()), format!("-L{}", folder.display())])
}

fn stub(install_name: &str, symbols: &[&str]) -> String {
    let targets = "[ x86_64-macos, arm64-macos ]";
    format!(
        "--- !tapi-tbd\ntbd-version: 4\ntargets: {targets}\ninstall-name: '{install_name}'\nexports:\n  - targets: {targets}\n    symbols: [ {} ]\n...\n",
        symbols.join(", ")
    )
}
