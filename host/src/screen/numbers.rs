//! The numbers below the plots, one subject per row.

use super::plots::{COLOURS, OLD};
use device::link::display;
use device::monitor::state::{State, Stiffness};
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Style, Stylize};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget};

/// Rows that all of them take.
pub const ROWS: u16 = 8;

/// Draws as many rows as fit.
pub fn draw(state: &State, now_s: f64, area: Rect, buffer: &mut Buffer) {
    let old = state.is_old(now_s);
    let mut lines = vec![head(old)];
    lines.extend(axes(state));
    lines.extend([phase(state), link(state, now_s), lost(state), device(state), counted(state)]);
    Paragraph::new(lines).render(area, buffer);
    if old {
        // Over all colours: nothing of it is true now.
        buffer.set_style(area.intersection(buffer.area), Style::new().fg(OLD));
    }
}

fn head(old: bool) -> Line<'static> {
    let text = format!("{:10}{:>12}{:>14}   {}", "", "position", "force", "stiffness on board (95 %)");
    let mark = if old { " OLD     " } else { "" };
    let tail = text.get(mark.len()..).unwrap_or_default().to_owned();
    Line::from(vec![mark.bold(), Span::from(tail).dark_gray()])
}

fn label(text: &str) -> Span<'static> {
    Span::from(format!(" {text:9}")).dark_gray()
}

fn row(name: &str, text: String) -> Line<'static> {
    Line::from(vec![label(name), text.into()])
}

fn axes(state: &State) -> [Line<'static>; 2] {
    let mean = state.mean();
    let [stiffness_x, stiffness_y] = state.stiffness();
    [("x", 0, stiffness_x), ("y", 1, stiffness_y)].map(|(name, axis, stiffness): (&str, usize, _)| {
        let numbers = mean
            .map(|(displacement_m, force_n)| (displacement_m.get(axis).copied(), force_n.get(axis).copied()));
        let measured = match numbers {
            Some((Some(metres), Some(newtons))) => {
                format!("{:>+9.3} mm {:>+11.4} N   ", 1e3 * metres, newtons)
            }
            _ => format!("{:>12}{:>14}   ", "-", "-"),
        };
        let colour = COLOURS.get(axis).copied().unwrap_or(Color::Reset);
        Line::from(vec![
            Span::from(format!(" {name:9}")).fg(colour).bold(),
            Span::from(measured).bold(),
            Span::from(stiffness.map_or("not identified yet: guide 2 must move".to_owned(), in_words)),
        ])
    })
}

fn in_words(stiffness: Stiffness) -> String {
    let Stiffness { value_n_per_m, ci95_n_per_m: [low, high] } = stiffness;
    format!("{:.3} ({:.3} to {:.3}) N/mm", 1e-3 * value_n_per_m, 1e-3 * low, 1e-3 * high)
}

fn phase(state: &State) -> Line<'static> {
    let phase = match state.phase {
        Some((phase, Some(step))) => format!("{}, step {step}", display::state(phase)),
        Some((phase, None)) => display::state(phase).to_owned(),
        None => "not known".to_owned(),
    };
    let clock = state.clock_s().map_or("-".to_owned(), |clock_s| format!("{clock_s:.1} s"));
    let telemetry = match &state.status {
        Some(status) if status.streaming => "on",
        Some(_) => "off",
        None => "not known",
    };
    Line::from(vec![
        label("state"),
        Span::from(phase).bold(),
        format!("   device clock {clock}   telemetry {telemetry}").into(),
    ])
}

fn link(state: &State, now_s: f64) -> Line<'static> {
    let [bytes_per_s, samples_per_s] = state.health.per_second();
    let received =
        state.silent_s(now_s).map_or("never".to_owned(), |silent_s| format!("{silent_s:.1} s ago"));
    row(
        "link",
        format!("{:.1} kB/s   {samples_per_s:.0} samples/s   last received {received}", bytes_per_s * 1e-3),
    )
}

fn lost(state: &State) -> Line<'static> {
    let losses = state.health.total().losses;
    let text = format!(
        "{} samples   {} frames missing   {} CRC errors   {} unreadable",
        losses.samples_missing, losses.frames_missing, losses.frames_corrupt, losses.frames_unreadable
    );
    let line = row("lost", text);
    if losses == Default::default() { line } else { line.fg(Color::LightRed) }
}

fn device(state: &State) -> Line<'static> {
    let text = match &state.status {
        Some(status) => {
            let [x, y] = status.motor_budget_permille.map(percent);
            format!(
                "CPU {:.0} %  longest period {} us  free stack {} B  motors {x:.0}, {y:.0} %",
                percent(status.load.cpu_permille),
                status.load.longest_period_us,
                status.load.stack_free_bytes,
            )
        }
        None => "-".to_owned(),
    };
    row("device", text)
}

fn percent(permille: u16) -> f64 {
    f64::from(permille) / 10.0
}

fn counted(state: &State) -> Line<'static> {
    let Some(status) = &state.status else { return row("counted", "-".to_owned()) };
    let counters = display::counters(&status.counters);
    let counted = counters.iter().filter(|(count, _)| *count > 0);
    let counted: Vec<String> = counted.map(|(count, what)| format!("{what}: {count}")).collect();
    if counted.is_empty() {
        row("counted", "no errors since the device started".to_owned())
    } else {
        row("counted", counted.join(", ")).fg(Color::LightRed)
    }
}
