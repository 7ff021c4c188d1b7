//! Whether a block shows what its command prints now, but for what differs from run to run.

use super::page::{Block, Made};
use regex::Regex;
use similar::TextDiff;
use std::sync::LazyLock;

/// Patterns of text that differs between runs, and their replacement on the page too.
const SHOWN: [(&str, &str); 2] = [
    // The folder of a run of the rig.
    (r"[^\s']*/needle-guide-\w{6}/", "/tmp/needle-guide-AbCdEf/"),
    // The commit that the firmware was built from.
    (r"(firmware \d+\.\d+\.\d+) \([^)]*\)", "$1 (1a2b3c4d5)"),
];

/// Patterns of text that differs between runs, and their replacement in a comparison.
const COMPARED: [(&str, &str); 6] = [
    // A free port of this machine.
    (r"(OpenIGTLink at 127\.0\.0\.1):\d+", "$1:0"),
    // Port and token of the page's address.
    (r"http://127\.0\.0\.1:\d+/[0-9a-f]{32}/", "http://127.0.0.1:0/0/"),
    // Seconds of this machine.
    (r"(start of QEMU to K:) [0-9.]+ s", "$1 0 s"),
    // The length of a raw recording depends on when the host requested the stream.
    (r"\d+ bytes", "0 bytes"),
    (r"(?m)^samples    .* of the device's clock$", "samples"),
    // And so is how many of its first frames came before the port was read; samples are requested later, and none is missing.
    (r"(?m)^(lost       0 samples), \d+ frames$", "$1"),
];

/// On a live screen, which shows the moment: what is drawn in plots, numbers, and the room that they take.
const LIVE: [(&str, &str); 3] = [(r"(?m)^.*│.*$", "│"), (r"[-+]?\d[\d.]*", "0"), (r"[ \t]+", " ")];

/// The part of the rig that shows the moment.
const LIVE_PART: &str = "live";

/// Patterns, and what stands for what they find.
type Stand = Vec<(Regex, &'static str)>;

fn compiled(list: &[(&str, &'static str)]) -> Stand {
    list.iter().map(|(pattern, with)| (Regex::new(pattern).expect("patterns are constants"), *with)).collect()
}

fn replaced(text: &str, stand: &Stand) -> String {
    stand.iter().fold(text.to_owned(), |text, (pattern, with)| pattern.replace_all(&text, *with).into_owned())
}

/// The text as the page shows it.
pub fn shown(text: &str) -> String {
    static PATTERNS: LazyLock<Stand> = LazyLock::new(|| compiled(&SHOWN));
    replaced(text, &PATTERNS)
}

/// Whether the block shows this already.
pub fn same(block: &Block, fresh: &str) -> bool {
    let (shown, fresh) = compared(block, fresh);
    shown == fresh
}

/// The difference, with its place.
pub fn difference(block: &Block, fresh: &str) -> String {
    let (shown, fresh) = compared(block, fresh);
    let diff = TextDiff::from_lines(&shown, &fresh);
    let diff = diff.unified_diff().context_radius(2).header(block.page(), "the command").to_string();
    format!("{}: the output is another one:\n{diff}", block.place())
}

/// Both texts without what differs by nature, and with the same numbers where they agree within the block's tolerance.
fn compared(block: &Block, fresh: &str) -> (String, String) {
    let (shown, fresh) = (normal(block, &block.text()), normal(block, fresh));
    let fresh = block.tolerance.settle(&shown, &fresh);
    (shown, fresh)
}

fn normal(block: &Block, text: &str) -> String {
    static EVERYWHERE: LazyLock<Stand> = LazyLock::new(|| compiled(&COMPARED));
    static MOMENT: LazyLock<Stand> = LazyLock::new(|| compiled(&LIVE));
    let text = replaced(&shown(&format!("{}\n", text.trim_end())), &EVERYWHERE);
    if block.made == Made::Rig(LIVE_PART.to_owned()) { replaced(&text, &MOMENT) } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readme::page::Page;

    fn block(made: &str, text: &str) -> Block {
        let page = format!("<!-- readme: {made} -->\n```console\n{text}\n```\n");
        Page::of("a.md", &page).blocks().unwrap().remove(0)
    }

    #[test]
    fn only_values_that_differ_between_runs_are_ignored() {
        let shown = block("rig demo", "$ guide home --port /tmp/needle-guide-KP2mC9/serial\nK 14.44 kPa");
        assert!(same(&shown, "$ guide home --port /var/needle-guide-a1b2c3/serial\nK 14.44 kPa\n"));
        let other_port = "$ guide home --port /tmp/needle-guide-KP2mC9/serial\nK 14.45 kPa\n";
        assert!(!same(&shown, other_port));
        let difference = difference(&shown, other_port);
        assert!(
            difference.starts_with("a.md:3: ") && difference.contains("-K 14.44 kPa\n+K 14.45 kPa"),
            "{difference}"
        );
    }

    #[test]
    fn frames_before_a_recording_may_be_as_many_as_they_are_but_no_sample_is_missing() {
        let shown = block("rig recording", "lost       0 samples, 8 frames");
        assert!(same(&shown, "lost       0 samples, 5 frames\n"));
        assert!(!same(&shown, "lost       2 samples, 5 frames\n"));
    }

    #[test]
    fn a_live_screen_may_show_another_moment_but_no_other_fields() {
        let shown = block("rig live", "   2.0│  ⠰⠶y\n y     +0.787 mm\n state    idle");
        assert!(same(&shown, "   3.0│ ⠰⠶⠶⠶⠶y\n y    -10.79 mm\n state    idle\n"));
        assert!(!same(&shown, "   3.0│ ⠰⠶⠶⠶⠶y\n y    -10.79 mm\n state    fault\n"));
    }
}
