//! The rows of the table: ours, the peers, whether they agree, and what the time could be at least.

use crate::clock::Clock;
use crate::machine::Machine;
use crate::forward::Own;
use crate::python::{Peer, Python};
use crate::{estimators, forward, session};
use anyhow::{Result, ensure};
use serde::Serialize;
use std::path::Path;

/// One operation.
pub struct Row {
    /// Name of the operation.
    pub name: &'static str,
    /// Seconds that ours takes.
    pub ours_s: f64,
    /// Peers that do the same.
    pub peers: Vec<Beside>,
    /// Common part of the two.
    pub same: String,
    /// Reference of the time, in words, and seconds; `None` if no meaningful one can be stated.
    pub limit: (String, Option<f64>),
}

/// A peer.
pub struct Beside {
    /// Name.
    pub name: String,
    /// Seconds; or why it does not run here.
    pub seconds: Result<f64, String>,
    /// Largest difference of its result from ours, over the largest number of the result.
    pub off: Option<f64>,
}

impl Row {
    /// The fastest peer.
    pub fn best(&self) -> Option<(&str, f64)> {
        let runs =
            self.peers.iter().filter_map(|peer| Some((peer.name.as_str(), *peer.seconds.as_ref().ok()?)));
        runs.min_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// A floating-point limit.
fn by_flops(machine: &Machine, flops: f64, of: &str) -> (String, Option<f64>) {
    (format!("{flops:.2e} operations ({of})"), Some(flops / machine.flops))
}

struct Table<'a> {
    python: Option<&'a Python>,
    rows: Vec<Row>,
}

impl Table<'_> {
    /// A row whose peers are in a script; every number has to be as near to ours as stated.
    fn row(
        &mut self,
        name: &'static str,
        script: &str,
        given: &impl Serialize,
        (own, nearness): (&Own, f64),
        same: &str,
        limit: (String, Option<f64>),
    ) -> Result<()> {
        let peers = self.python.map(|python| python.peers(script, given)).transpose()?.unwrap_or_default();
        let peers = peers.into_iter().map(|peer| beside(peer, own, nearness)).collect::<Result<_>>()?;
        self.rows.push(Row { name, ours_s: own.seconds, peers, same: same.to_owned(), limit });
        Ok(())
    }
}

fn beside(peer: Peer, own: &Own, nearness: f64) -> Result<Beside> {
    let Some(seconds) = peer.seconds else {
        return Ok(Beside { name: peer.name, seconds: Err(peer.error.unwrap_or_default()), off: None });
    };
    let compared = !own.result.is_empty();
    ensure!(
        !compared || peer.result.len() == own.result.len(),
        "{}: {} numbers",
        peer.name,
        peer.result.len()
    );
    let scale = own.result.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    let differences = own.result.iter().zip(&peer.result).map(|(a, b)| (a - b).abs() / scale);
    let largest_difference = compared.then(|| differences.fold(0.0, f64::max));
    ensure!(largest_difference.is_none_or(|largest_difference| largest_difference < nearness), "{} is off by {largest_difference:?} of ours", peer.name);
    Ok(Beside { name: peer.name, seconds: Ok(seconds), off: largest_difference })
}

/// Measures all of them.
pub fn measure(
    clock: &mut Clock,
    python: Option<&Python>,
    machine: &Machine,
    cache: &Path,
    seed: u64,
) -> Result<Vec<Row>> {
    let mut table = Table { python, rows: Vec::new() };

    let beam = forward::beam(clock)?;
    // Three pieces: fundamental solutions of 1, 1 and 5 groups of terms, sweeps to the clamp and back, 16 coefficients of the series in
    // the tissue for both loads (elsewhere it ends by itself), 41 deflections by 24 terms.
    let flops = 7.0 * 26.0 + 3.0 * (105.0 + 40.0) + 2.0 * 16.0 * 5.0 + 41.0 * 48.0;
    let limit = by_flops(machine, flops, "series, sweeps, 41 deflections");
    table.row("beam solve", "beam", &(), (&beam, 1e-3), "beam, load, 41 deflections", limit)?;

    let identification = forward::identification(clock)?;
    let runs = forward::model_runs()?;
    let limit = (format!("{runs} beam solves that it needs"), Some(runs as f64 * beam.seconds));
    table.row(
        "identification of a run",
        "identification",
        &(),
        (&identification, 1e-4),
        "data, weights, unknowns",
        limit,
    )?;

    let insertion = forward::insertion(clock)?;
    // Per step and element: back substitution of two unknowns, weights of the path, and their sum.
    let flops = 280.0 * 280.0 / 2.0 * (2.0 * 7.0 + 14.0 + 4.0);
    let limit = by_flops(machine, flops, "back substitutions and weights");
    table.row(
        "insertion simulation, 280 steps",
        "insertion",
        &(),
        (&insertion, 1e-6),
        "elements, springs, path",
        limit,
    )?;

    let (seconds, size) = estimators::prediction(clock)?;
    let unknowns = size.unknowns as f64;
    // Per part the update, its covariance into the sum, and the means; per candidate the variances.
    let flops = size.parts as f64 * (6.0 * unknowns * unknowns + 2.0 * unknowns * size.depths as f64)
        + size.candidates as f64 * 2.0 * unknowns * (unknowns + 1.0) * size.depths as f64;
    let limit = by_flops(machine, flops, "update and means of every part, variances of every candidate");
    let own_result = Own { seconds, result: Vec::new() };
    let common_part = format!(
        "size: {} parts, {} unknowns, {} depths; other numbers, and a covariance per part, ours sums those of one candidate",
        size.parts, size.unknowns, size.depths
    );
    table.row("prediction, one reading and the path again", "predict", &size, (&own_result, 1.0), &common_part, limit)?;

    let rows = estimators::rows(seed);
    let recursive = estimators::recursive(clock, &rows)?;
    let n = estimators::UNKNOWNS as f64;
    let limit = by_flops(machine, 3.0 * n * n + n * n, "rotations and back substitution");
    table.row(
        "least squares, one row and the estimate",
        "recursive",
        &rows,
        (&recursive, 1e-8),
        "rows, prior, 18 unknowns",
        limit,
    )?;

    let peers = table.rows.last().map(|row| row.peers.iter().map(repeated).collect()).unwrap_or_default();
    table.rows.push(Row {
        name: "online estimator, one sample",
        ours_s: estimators::online(clock, seed)?,
        peers,
        same: "18 unknowns; peers take in one row, ours simulates the needle and replays too".to_owned(),
        limit: ("control period of the device".to_owned(), Some(1e-3)),
    });

    let diagnosis = estimators::diagnosis(clock)?;
    table.rows.push(Row {
        name: "diagnosis of nine runs",
        ours_s: diagnosis,
        peers: Vec::new(),
        same: "nothing that runs here does it".to_owned(),
        limit: ("none: a search".to_owned(), None),
    });

    let folder = cache.join("session");
    let bytes = session::write(&folder, session::ROWS)?;
    let loaded = session::load(clock, &folder)?;
    let limit =
        (format!("{:.1} MB read from memory", 1e-6 * bytes as f64), Some(bytes as f64 / machine.bytes));
    let request = serde_json::json!({ "folder": folder });
    table.row(
        "session load",
        "session",
        &request,
        (&loaded, 1e-9),
        "files, columns, units; ours also checks every cell",
        limit,
    )?;
    Ok(table.rows)
}

fn repeated(peer: &Beside) -> Beside {
    Beside { name: peer.name.clone(), seconds: peer.seconds.clone(), off: None }
}
