//! Live screens: that of `guide monitor`, a [`view`] of the state of [`device::monitor`], and that of `guide steer`, a view of
//! [a run](steering). Only the program handles a real terminal and keys.

pub mod view;

mod numbers;
mod plots;
mod steered;

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::widgets::Widget;

#[cfg(test)]
#[path = "../../device/src/monitor/testing.rs"]
mod testing;

pub use steered::{SteerScreen, SteerView};
pub use view::{Screen, Settings};

/// A screen as lines of text, for logs and documents.
fn text_of(screen: impl Widget, width: u16, height: u16) -> String {
    let area = Rect::new(0, 0, width, height);
    let mut buffer = Buffer::empty(area);
    screen.render(area, &mut buffer);
    (0..height)
        .map(|y| {
            let line: String =
                (0..width).filter_map(|x| buffer.cell((x, y))).map(|cell| cell.symbol()).collect();
            format!("{}\n", line.trim_end())
        })
        .collect()
}
