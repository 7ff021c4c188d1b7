//! A report as one HTML file: no scripts, no network, no fonts of its own; for the screen in light and dark, and for paper.

use super::page::{Block, Column, Figure, Outcome, Report, Section, Table};
use crate::foreign::acts;
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Colours of the figures are mapped to those of the page by their attributes, so that figures follow light, dark and paper.
const STYLE: &str = include_str!("style.css");

/// The page.
pub(super) fn page(report: &Report) -> String {
    let Report { name, warnings, summary, sections, date } = report;
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (name) ": needle guide report" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                header {
                    h1 { (name) }
                    p { "Needle guide report, " (date) }
                }
                main {
                    @if !warnings.is_empty() {
                        section class="warnings" aria-labelledby="warnings" {
                            h2 id="warnings" { "Warnings" }
                            ul { @for warning in warnings { li { (warning) } } }
                        }
                    }
                    section class="summary" aria-labelledby="summary" {
                        h2 id="summary" { "Summary" }
                        @if summary.is_empty() { p { "There is no result." } }
                        @else { dl { @for fact in summary { div { dt { (fact.name) } dd { (fact.value) } } } } }
                        nav aria-label="Sections" {
                            ul { @for section in sections { li { a href={ "#" (section.id) } { (section.title) } } } }
                        }
                    }
                    @for one in sections { (section(one)) }
                }
            }
        }
    };
    printable(page.into_string())
}

/// Control characters that names may hold are in no HTML.
fn printable(text: String) -> String {
    if text.contains(acts) { text.replace(acts, "\u{fffd}") } else { text }
}

fn section(section: &Section) -> Markup {
    html! {
        section aria-labelledby=(section.id) {
            h2 id=(section.id) { (section.title) }
            @match &section.content {
                Outcome::NotThere(what) => p class="quiet" { "Skipped: " (what) "." },
                Outcome::Failed(why) => p class="failed" { strong { "Failed: " } (why) },
                Outcome::Found(blocks) => @for one in blocks { (block(one)) },
            }
        }
    }
}

fn block(block: &Block) -> Markup {
    match block {
        Block::Heading(text) => html! { h3 { (text) } },
        Block::Text(text) => html! { p { (text) } },
        Block::Notes(notes) if notes.is_empty() => html! {},
        Block::Notes(notes) => html! { ul class="notes" { @for note in notes { li { (note) } } } },
        Block::Table(of) => table(of),
        Block::Figure(of) => figure(of),
        Block::Screen(parts) => html! { div class="screen" { @for part in parts { (self::block(part)) } } },
    }
}

/// Wide tables scroll by themselves, so that the page never does; by keys too.
fn table(table: &Table) -> Markup {
    let Table { caption, columns, rows } = table;
    html! {
        div class="wide" role="region" aria-label=(caption) tabindex="0" {
            table {
                caption { (caption) }
                thead { tr { @for column in columns { th scope="col" class=[class(Some(column))] { (column.name) } } } }
                tbody {
                    @for row in rows {
                        tr {
                            @for (index, cell) in row.iter().enumerate() {
                                @if index == 0 { th scope="row" { (cell) } }
                                @else { td class=[class(columns.get(index))] { (cell) } }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn class(column: Option<&Column>) -> Option<&str> {
    column.filter(|column| column.is_number).map(|_| "number")
}

fn figure(figure: &Figure) -> Markup {
    let Figure { caption, svg } = figure;
    // Half of a drawing are attributes with the values that they have anyway; in texts their quotes would be escaped.
    let svg = [" opacity=\"1\"", " stroke=\"none\"", " stroke-width=\"1\""]
        .into_iter()
        .fold(svg.clone(), |svg, given| svg.replace(given, ""));
    // The drawing gets a title of its own; its text is escaped by the library that drew it.
    let (opening, svg_body) = svg.split_once('>').unwrap_or(("<svg", "</svg>"));
    html! {
        figure {
            (PreEscaped(opening)) (PreEscaped(" role=\"img\">")) title { (caption) } (PreEscaped(svg_body))
            figcaption { (caption) }
        }
    }
}
