//! Every link of the pages leads somewhere: to a page, a heading of it, or a file of the project.

use super::book::{Book, MANUAL};
use crate::images;
use pulldown_cmark::{Event, Options, Parser, Tag, TagEnd};
use std::collections::{BTreeMap, BTreeSet};

/// Targets of a page's links, and anchors of the page.
#[derive(Debug, Default)]
struct Ends {
    links: Vec<String>,
    anchors: BTreeSet<String>,
}

/// As `mdbook` and GitHub make the anchor of a heading.
fn anchor(heading: &str) -> String {
    let anchor_characters = heading.trim().chars().filter_map(|c| match c {
        c if c.is_alphanumeric() || c == '_' || c == '-' => Some(c),
        c if c.is_whitespace() => Some('-'),
        _ => None,
    });
    anchor_characters.flat_map(char::to_lowercase).collect()
}

fn ends(text: &str) -> Ends {
    let mut ends = Ends::default();
    let mut heading: Option<String> = None;
    for event in Parser::new_ext(text, Options::ENABLE_TABLES) {
        match event {
            Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
                ends.links.push(dest_url.into_string());
            }
            Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
            Event::Text(part) | Event::Code(part) => {
                if let Some(heading) = &mut heading {
                    heading.push_str(&part);
                }
            }
            Event::End(TagEnd::Heading(_)) => {
                let name = anchor(&heading.take().unwrap_or_default());
                // A second heading of the same name gets a number.
                let twice = (1..).map(|count| format!("{name}-{count}"));
                let free =
                    std::iter::once(name.clone()).chain(twice).find(|name| !ends.anchors.contains(name));
                ends.anchors.extend(free);
            }
            Event::Html(html) | Event::InlineHtml(html) => {
                let named = html.split("id=\"").skip(1).filter_map(|rest| rest.split_once('"'));
                ends.anchors.extend(named.map(|(name, _)| name.to_owned()));
            }
            _ => {}
        }
    }
    ends
}

/// The path from the root that a link on this page means.
fn resolved(page: &str, link: &str) -> String {
    let mut segments: Vec<&str> = page.split('/').collect();
    segments.pop();
    for part in link.split('/') {
        match part {
            "" | "." => {}
            ".." if segments.last().is_some_and(|last| *last != "..") => {
                segments.pop();
            }
            part => segments.push(part),
        }
    }
    segments.join("/")
}

/// Faults of these pages' links.
fn complaints(book: &Book) -> Vec<String> {
    let ends: BTreeMap<&str, Ends> =
        book.pages().iter().map(|page| (page.name(), ends(&page.text()))).collect();
    let mut complaints = Vec::new();
    for (page, of_page) in &ends {
        for link in &of_page.links {
            if link.contains("://") {
                continue;
            }
            let (path, fragment) = link.split_once('#').map_or((link.as_str(), None), |(a, b)| (a, Some(b)));
            let target = if path.is_empty() { (*page).to_owned() } else { resolved(page, path) };
            let is_there = ends.contains_key(target.as_str()) || images::root().join(&target).exists();
            if !is_there || target.starts_with("..") {
                complaints.push(format!("{page}: {link}: no file {target}"));
            } else if page.starts_with(MANUAL) && !target.starts_with(MANUAL) {
                // The manual as a site has nothing beside its own folder.
                complaints.push(format!("{page}: {link}: leads out of the manual"));
            } else if let (Some(fragment), Some(target)) = (fragment, ends.get(target.as_str()))
                && !target.anchors.contains(fragment)
            {
                complaints.push(format!("{page}: {link}: no heading or anchor {fragment}"));
            }
        }
    }
    complaints
}

#[test]
fn every_link_leads_somewhere() {
    let broken_links = complaints(&Book::read(images::root()).unwrap());
    assert!(broken_links.is_empty(), "{}", broken_links.join("\n"));
}

#[test]
fn links_that_lead_nowhere_are_named() {
    use crate::readme::page::Page;
    let page = "# A `b`: c\n\n## Twice\n\n## Twice\n\n<a id=\"eq-1\"></a>\n\n\
                [1](#a-b-c) [2](#twice-1) [3](other.md#eq-1) [4](../README.md) [5](https://example.org/#x)\n\n\
                ```\n[not a link](nowhere.md)\n```\n\n[6](#d) [7](gone.md) [8](other.md#eq-2) ![9](gone.svg)\n";
    let inner_path = format!("{MANUAL}/a.md");
    let other_page = Page::of("host/other.md", "<a id=\"eq-1\"></a>\n");
    let outer_page = Page::of(&inner_path, "[10](../../../README.md)\n");
    let broken_links = complaints(&Book::of(vec![Page::of("host/a.md", page), other_page, outer_page]));
    assert_eq!(
        broken_links,
        [
            "host/a.md: #d: no heading or anchor d",
            "host/a.md: gone.md: no file host/gone.md",
            "host/a.md: other.md#eq-2: no heading or anchor eq-2",
            "host/a.md: gone.svg: no file host/gone.svg",
            "host/manual/src/a.md: ../../../README.md: leads out of the manual",
        ]
    );
}

/// A link of an identifier of the literature has the same identifier as text and target, in the form that the registry
/// prescribes.
#[test]
fn every_doi_is_its_own_link() {
    let book = Book::read(images::root()).unwrap();
    let page = book.page(&format!("{MANUAL}/bibliography.md")).unwrap();
    let form = regex::Regex::new(r"^10\.\d{4,9}/[-._;()/:A-Za-z0-9]+$").unwrap();
    let (mut count, mut target) = (0, None);
    for event in Parser::new(&page.text()) {
        match event {
            Event::Start(Tag::Link { dest_url, .. }) => {
                target = dest_url.strip_prefix("https://doi.org/").map(str::to_owned);
            }
            Event::Text(text) if target.is_some() => {
                assert!(form.is_match(&text), "{text}: not the form of a DOI");
                assert_eq!(target.take().as_deref(), Some(&*text));
                count += 1;
            }
            _ => {}
        }
    }
    assert!(count > 10, "{count} DOIs");
}
