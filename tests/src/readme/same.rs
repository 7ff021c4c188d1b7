//! Whether a block says what its command says now, but for what differs from run to run.

use super::page::{Block, Made};
use regex::Regex;
use similar::TextDiff;
use std::sync::LazyLock;

/// What differs by nature, and what stands for it in a comparison.
const EVERYWHERE: [(&str, &str); 5] = [
    // The folder of a run of the rig.
    (r"[^\s']*/needle-guide-\w{6}/", "/tmp/needle-guide-AbCdEf/"),
    // Seconds of this machine.
    (r"(start of QEMU to K:) [0-9.]+ s", "$1 0 s"),
    // How long a raw recording is depends on when the host asked for the stream.
    (r"\d+ bytes", "0 bytes"),
    (r"(?m)^samples    .* of the device's clock$", "samples"),
    // The commit that the firmware was built from.
    (r"(firmware \d+\.\d+\.\d+) \([^)]*\)", "$1 (0)"),
];

/// On a live screen, which shows the moment: what is drawn in plots, numbers, and the room that they take.
const LIVE: [(&str, &str); 3] = [(r"(?m)^.*│.*$", "│"), (r"[-+]?\d[\d.]*", "0"), (r"[ \t]+", " ")];

/// The part of the rig that shows the moment.
const LIVE_PART: &str = "live";

static PATTERNS: LazyLock<[Vec<(Regex, &str)>; 2]> = LazyLock::new(|| {
    let compiled = |list: &[(&str, &'static str)]| {
        list.iter()
            .map(|(pattern, with)| (Regex::new(pattern).expect("patterns are constants"), *with))
            .collect()
    };
    [compiled(&EVERYWHERE), compiled(&LIVE)]
});

/// Whether the block says this already.
pub fn same(block: &Block, fresh: &str) -> bool {
    normal(block, &block.text()) == normal(block, fresh)
}

/// The difference, with its place.
pub fn told(block: &Block, fresh: &str) -> String {
    let (shown, fresh) = (normal(block, &block.text()), normal(block, fresh));
    let diff = TextDiff::from_lines(&shown, &fresh);
    let diff = diff.unified_diff().context_radius(2).header("README.md", "the command").to_string();
    format!("{}: the output is another one:\n{diff}", block.place())
}

fn normal(block: &Block, text: &str) -> String {
    let live = block.made == Made::Rig(LIVE_PART.to_owned());
    let [everywhere, moment] = &*PATTERNS;
    let mut text = format!("{}\n", text.trim_end());
    for (pattern, with) in everywhere.iter().chain(moment.iter().filter(|_| live)) {
        text = pattern.replace_all(&text, *with).into_owned();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readme::page::Page;

    fn block(made: &str, text: &str) -> Block {
        let page = format!("<!-- readme: {made} -->\n```console\n{text}\n```\n");
        Page::of(&page).blocks().unwrap().remove(0)
    }

    #[test]
    fn only_what_differs_by_nature_is_forgiven() {
        let shown = block("rig demo", "$ guide home --port /tmp/needle-guide-KP2mC9/serial\nK 14.44 kPa");
        assert!(same(&shown, "$ guide home --port /var/needle-guide-a1b2c3/serial\nK 14.44 kPa\n"));
        let other = "$ guide home --port /tmp/needle-guide-KP2mC9/serial\nK 14.45 kPa\n";
        assert!(!same(&shown, other));
        let told = told(&shown, other);
        assert!(told.starts_with("README.md:3: ") && told.contains("-K 14.44 kPa\n+K 14.45 kPa"), "{told}");
    }

    #[test]
    fn a_live_screen_may_show_another_moment_but_no_other_fields() {
        let shown = block("rig live", "   2.0│  ⠰⠶y\n y     +0.787 mm\n state    idle");
        assert!(same(&shown, "   3.0│ ⠰⠶⠶⠶⠶y\n y    -10.79 mm\n state    idle\n"));
        assert!(!same(&shown, "   3.0│ ⠰⠶⠶⠶⠶y\n y    -10.79 mm\n state    fault\n"));
    }
}
