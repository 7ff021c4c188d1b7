//! The manual as one page: all chapters as mdBook prints them, with the pictures in it, without scripts.

use anyhow::{Context, Result, ensure};
use std::fmt::Write;
use std::fs;
use std::path::Path;

/// All chapters in one page.
const PRINTED: &str = "print.html";
const STYLE: &str = include_str!("../../texts/manual.css");

/// The page.
///
/// # Errors
/// Where mdBook's page is not there or not as expected, or a picture cannot be read.
pub fn one_page(site: &Path, version: &str) -> Result<String> {
    let path = site.join(PRINTED);
    let printed = fs::read_to_string(&path).with_context(|| format!("{}: cannot read", path.display()))?;
    let chapters =
        between(&printed, "<main>", "</main>").with_context(|| format!("{}: no chapters", path.display()))?;
    let chapters = without_pages(&with_pictures(chapters, site)?);
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width\">\n\
         <title>Actuated needle guide {version}: manual</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n\
         <h1>Actuated needle guide {version}: manual</h1>\n<nav>\n<ul>\n"
    );
    for (id, title) in headings(&chapters) {
        let _ = writeln!(page, "<li><a href=\"#{id}\">{title}</a></li>");
    }
    let _ = write!(page, "</ul>\n</nav>\n<main>\n{chapters}\n</main>\n</body>\n</html>\n");
    ensure!(!page.contains("<script"), "{}: a script in a chapter", path.display());
    Ok(page)
}

fn between<'t>(text: &'t str, begin: &str, end: &str) -> Option<&'t str> {
    let (_, text_after) = text.split_once(begin)?;
    Some(text_after.rsplit_once(end)?.0)
}

/// Pictures take the place of their addresses.
fn with_pictures(text: &str, site: &Path) -> Result<String> {
    const SOURCE: &str = "src=\"";
    let mut page = String::with_capacity(2 * text.len());
    let mut remaining_text = text;
    while let Some((text_before, text_after)) = remaining_text.split_once(SOURCE) {
        let (address, source_tail) =
            text_after.split_once('"').context("a picture without an end of its address")?;
        page.push_str(text_before);
        page.push_str(SOURCE);
        match address.rsplit_once('.') {
            Some((_, "svg")) if !address.contains("://") => {
                let path = site.join(address);
                let picture =
                    fs::read_to_string(&path).with_context(|| format!("{}: cannot read", path.display()))?;
                page.push_str("data:image/svg+xml,");
                page.push_str(&encoded(&picture));
            }
            _ => page.push_str(address),
        }
        page.push('"');
        remaining_text = source_tail;
    }
    page.push_str(remaining_text);
    Ok(page)
}

/// Characters that an address may not have, and those that would end it, as `%` and two digits.
fn encoded(text: &str) -> String {
    let mut address = String::with_capacity(text.len() + text.len() / 4);
    for byte in text.bytes() {
        if byte.is_ascii_alphanumeric() || b" !$&'()*+,-./:;=?@_~".contains(&byte) {
            address.push(char::from(byte));
        } else {
            let _ = write!(address, "%{byte:02X}");
        }
    }
    address
}

/// Links that name a page beside this one: to the place in this one where they name a place, and else to the page's first heading.
fn without_pages(text: &str) -> String {
    const LINK: &str = "href=\"";
    let mut page = String::with_capacity(text.len());
    let mut remaining_text = text;
    while let Some((text_before, text_after)) = remaining_text.split_once(LINK) {
        let (address, link_tail) = text_after.split_once('"').unwrap_or((text_after, ""));
        page.push_str(text_before);
        page.push_str(LINK);
        let (file, page_file) = address.split_once('#').unwrap_or((address, ""));
        let is_page = file.ends_with(".html") && !file.contains("://");
        match (is_page, page_file) {
            (true, "") => {
                let name = file.rsplit('/').next().unwrap_or(file).trim_end_matches(".html");
                let _ = write!(page, "#{name}");
            }
            (true, page_file) => {
                let _ = write!(page, "#{page_file}");
            }
            (false, _) => page.push_str(address),
        }
        page.push('"');
        remaining_text = link_tail;
    }
    page.push_str(remaining_text);
    page
}

/// The chapters' headings with their places.
fn headings(chapters: &str) -> Vec<(&str, String)> {
    let heads = chapters.split("<h1 id=\"").skip(1);
    let heading_ids = heads.filter_map(|head| {
        let (id, heading_tail) = head.split_once('"')?;
        let heading_text = heading_tail.split_once('>')?.1.split("</h1>").next()?;
        Some((id, plain(heading_text)))
    });
    heading_ids.collect()
}

/// A text without tags.
fn plain(text: &str) -> String {
    let mut is_tag = false;
    let letters = text.chars().filter(|letter| match letter {
        '<' => {
            is_tag = true;
            false
        }
        '>' => !std::mem::replace(&mut is_tag, false),
        _ => !is_tag,
    });
    letters.collect::<String>().trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRINTED_PAGE: &str = "<html><script>1</script><main><h1 id=\"a\"><a class=\"header\" href=\"#a\">One &amp; <code>two</code></a></h1>\
        <p><a href=\"commands/init.html\">x</a> <a href=\"web.html#live\">y</a> <a href=\"https://a.example/b.html\">z</a></p>\
        <img src=\"pictures/p.svg\" alt=\"\"></main></html>";

    fn page() -> String {
        let site = tempfile::tempdir().unwrap();
        fs::create_dir(site.path().join("pictures")).unwrap();
        fs::write(site.path().join("pictures/p.svg"), "<svg fill=\"#fff\">\u{b5}</svg>").unwrap();
        fs::write(site.path().join(PRINTED), PRINTED_PAGE).unwrap();
        one_page(site.path(), "1.2.3").unwrap()
    }

    #[test]
    fn the_page_needs_no_other_file() {
        let page = page();
        assert!(
            page.contains("src=\"data:image/svg+xml,%3Csvg fill=%22%23fff%22%3E%C2%B5%3C/svg%3E\""),
            "{page}"
        );
        for link in ["href=\"#init\"", "href=\"#live\"", "href=\"https://a.example/b.html\""] {
            assert!(page.contains(link), "{link}");
        }
        assert!(!page.contains("<script"));
    }

    #[test]
    fn chapters_are_listed_by_their_headings() {
        assert!(page().contains("<li><a href=\"#a\">One &amp; two</a></li>"), "{}", page());
    }
}
