//! Preprocessor of mdBook: the book on standard input, the same with its equations typeset on standard output.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::io::{Read, Write};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        // MathML is for all that shows HTML.
        ["supports", renderer] => {
            ensure!(renderer == "html", "{renderer}: expected html");
            Ok(())
        }
        [] => preprocess(),
        _ => anyhow::bail!("expected no arguments, or `supports RENDERER`"),
    }
}

/// mdBook gives a list of context and book, and takes the book.
fn preprocess() -> Result<()> {
    let mut text = String::new();
    std::io::stdin().read_to_string(&mut text).context("standard input")?;
    let input: Value = serde_json::from_str(&text).context("standard input")?;
    let [_context, mut book]: [Value; 2] =
        serde_json::from_value(input).context("expected context and book")?;
    typeset(&mut book)?;
    std::io::stdout().write_all(book.to_string().as_bytes()).context("standard output")
}

/// Typesets the chapters, wherever they are in the book: an object with text and a path is one.
fn typeset(value: &mut Value) -> Result<()> {
    match value {
        Value::Array(values) => values.iter_mut().try_for_each(typeset),
        Value::Object(fields) => {
            let path = fields.get("path").and_then(Value::as_str).map(str::to_owned);
            if let (Some(path), Some(Value::String(content))) = (path, fields.get_mut("content")) {
                *content = equations::typeset(content).with_context(|| path.clone())?;
            }
            fields.values_mut().try_for_each(typeset)
        }
        _ => Ok(()),
    }
}
