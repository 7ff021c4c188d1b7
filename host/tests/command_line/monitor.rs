//! `guide monitor` where it cannot work: one line, and no screen.

use super::failure;

#[test]
fn without_a_terminal_there_is_no_screen() {
    let line = failure(&["monitor", "--port", "/dev/no-such-port"]);
    assert_eq!(line, "error: needs a terminal; for machines use `guide status --json` or `guide record`");
}

#[test]
fn rejects_a_port_without_a_device() {
    for form in ["--once", "--json"] {
        let line = failure(&["monitor", "--port", "/dev/no-such-port", form]);
        assert!(line.starts_with("error: /dev/no-such-port: no such port"), "{line}");
    }
}
