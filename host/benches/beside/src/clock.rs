//! Times of single operations, by criterion: warm-up, a hundred samples, and of those the least time per call, which is what it takes
//! when nothing else on the machine disturbs it.

use anyhow::{Context, Result};
use criterion::Criterion;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Samples that criterion keeps of a measurement: calls of every sample, and nanoseconds.
#[derive(Deserialize)]
struct Samples {
    iters: Vec<f64>,
    times: Vec<f64>,
}

/// Measures one operation after the other.
pub struct Clock {
    criterion: Criterion,
    folder: PathBuf,
}

impl Clock {
    /// Keeps its files in a folder.
    pub fn new(folder: &Path) -> Self {
        let criterion = Criterion::default()
            .without_plots()
            .output_directory(folder)
            .warm_up_time(Duration::from_millis(200))
            .measurement_time(Duration::from_millis(1000));
        Self { criterion, folder: folder.to_owned() }
    }

    /// Seconds that a call takes. The returned value is used, so that the work is done.
    pub fn seconds<T>(&mut self, name: &str, mut work: impl FnMut() -> T) -> Result<f64> {
        let id: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
        self.criterion.bench_function(&id, |bencher| bencher.iter(&mut work));
        let path = self.folder.join(&id).join("new").join("sample.json");
        let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        let Samples { iters, times } = serde_json::from_str(&text)?;
        let call_times_s = times.iter().zip(&iters).map(|(nanoseconds, calls)| 1e-9 * nanoseconds / calls);
        call_times_s.min_by(f64::total_cmp).with_context(|| format!("{}: no samples", path.display()))
    }

    /// The same of work that takes a second or so: the least of ten calls.
    pub fn seconds_of_long<T>(&mut self, name: &str, work: impl FnMut() -> T) -> Result<f64> {
        let short = std::mem::take(&mut self.criterion);
        self.criterion = short.without_plots().output_directory(&self.folder).sample_size(10);
        let seconds = self.seconds(name, work);
        *self = Self::new(&self.folder);
        seconds
    }
}
