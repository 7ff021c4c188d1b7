//! The program as mdBook calls it.

use serde_json::{Value, json};
use std::io::Write;
use std::process::{Command, Output, Stdio};

fn equations(arguments: &[&str], input: &str) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_equations"))
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    program.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
    program.wait_with_output().unwrap()
}

fn chapter(content: &str, path: &str, sub_items: &Value) -> Value {
    json!({"Chapter": {"name": path, "content": content, "path": path, "sub_items": sub_items}})
}

/// Context and book, with a chapter below another one.
fn book(tex: &str) -> String {
    let page = format!("```text\na/b\n```\n<!-- tex\n{tex}\n-->\n");
    let equation_chapter = chapter(&page, "theory/beam.md", &json!([]));
    let theory_chapter = chapter("Text.\n", "theory.md", &json!([equation_chapter]));
    json!([{"root": "/book"}, {"items": [theory_chapter, "Separator"]}]).to_string()
}

#[test]
fn every_chapter_is_typeset_and_all_else_is_kept() {
    let output = equations(&[], &book("\\frac{a}{b}"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let typeset: Value = serde_json::from_slice(&output.stdout).unwrap();
    let theory_chapter = &typeset["items"][0]["Chapter"];
    assert_eq!(theory_chapter["content"], "Text.\n");
    assert!(
        theory_chapter["sub_items"][0]["Chapter"]["content"].as_str().unwrap().contains("<mfrac>"),
        "{typeset}"
    );
    assert_eq!(typeset["items"][1], "Separator");
}

#[test]
fn an_equation_that_is_not_understood_ends_the_build_with_its_place() {
    let output = equations(&[], &book("\\frac{a"));
    assert!(!output.status.success());
    let reason = String::from_utf8_lossy(&output.stderr);
    assert!(reason.contains("theory/beam.md") && reason.contains("line 4"), "{reason}");
}

#[test]
fn it_is_for_pages_only() {
    assert!(equations(&["supports", "html"], "").status.success());
    assert!(!equations(&["supports", "epub"], "").status.success());
    assert!(!equations(&["typeset"], "").status.success());
}
