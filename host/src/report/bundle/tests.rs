use super::*;

#[test]
fn a_list_of_others_is_followed_only_within_the_bundle() {
    assert_eq!(list("phantom", 250).fault(), None);
    for session in ["..", "/etc", "a/b", "", "."] {
        let fault = list(session, 250).fault().expect("a fault");
        assert!(fault.starts_with("session: "), "{fault}");
    }
    let fault = list("phantom", 1_000_000_000).fault().expect("a fault");
    assert!(fault.contains("expected 1 to 16 and 1 to 10000"), "{fault}");
}

fn list(session: &str, draws_per_chain: usize) -> List {
    List {
        schema: SCHEMA.to_owned(),
        program: "guide".to_owned(),
        session: session.to_owned(),
        until_mm: 50.0,
        model: false,
        characterized: false,
        date: "2025-03-01".to_owned(),
        chains: 4,
        draws_per_chain,
        seed: 1,
        inputs: Vec::new(),
        results: Vec::new(),
    }
}

#[test]
fn texts_do_not_say_where_they_were_computed() {
    let text = anywhere("at /tmp/x/a/b.csv, line 2; /tmp/xy", Path::new("/tmp/x"));
    assert_eq!(text, "at a/b.csv, line 2; /tmp/xy");
}
