//! The table of `cargo xtask study images`.

use super::{Imaged, Modulus};

/// Table of all runs together.
pub(super) fn table(all: &[Imaged]) -> String {
    let count = all.len();
    let of = |good: &dyn Fn(&Imaged) -> bool| all.iter().filter(|one| good(one)).count();
    let mean = |value: &dyn Fn(&Imaged) -> f64| all.iter().map(value).sum::<f64>() / count.max(1) as f64;
    let most = |value: &dyn Fn(&Imaged) -> f64| all.iter().map(value).fold(0.0, f64::max);
    let error = |modulus: fn(&Imaged) -> &Modulus| {
        100.0 * mean(&|one| (modulus(one).k_kpa / one.true_kpa - 1.0).powi(2)).sqrt()
    };
    let beside_truth = |one: &Imaged| one.of_images.width_kpa() / one.of_truth.width_kpa();
    let beside_numbers = |one: &Imaged| one.of_images.width_kpa() / one.of_numbers.width_kpa();
    let sum = |value: &dyn Fn(&Imaged) -> usize| all.iter().map(value).sum::<usize>();
    let shifted = |one: &Imaged| 100.0 * (one.of_shifted.k_kpa / one.of_images.k_kpa - 1.0);
    let root = |squares: fn(&Imaged) -> [f64; 2], axis: usize| mean(&|one| squares(one)[axis]).sqrt();
    let stated =
        |modulus: fn(&Imaged) -> &Modulus| mean(&|one| modulus(one).off_sd(one.true_kpa).powi(2)).sqrt();
    let rows = [
        (
            "true K in the interval of K from images",
            format!("{} of {count}", of(&|one| one.of_images.holds(one.true_kpa))),
        ),
        (
            "K from the true shape in the interval of K from images",
            format!("{} of {count}", of(&|one| one.of_images.holds(one.of_truth.k_kpa))),
        ),
        (
            "error of K, rms: images; true shape; shape as numbers, 0.025 mm a point",
            format!(
                "{:.2} %; {:.2} %; {:.2} %",
                error(|one| &one.of_images),
                error(|one| &one.of_truth),
                error(|one| &one.of_numbers)
            ),
        ),
        (
            "the same in stated standard deviations: images; shape as numbers",
            format!("{:.2}; {:.2}", stated(|one| &one.of_images), stated(|one| &one.of_numbers)),
        ),
        (
            "interval beside that from the true shape, mean (largest)",
            format!("{:.2} ({:.2})", mean(&beside_truth), most(&beside_truth)),
        ),
        (
            "interval beside that from the shape as numbers, mean (largest)",
            format!("{:.2} ({:.2})", mean(&beside_numbers), most(&beside_numbers)),
        ),
        (
            "frames: used, rejected, used though they show something else",
            format!("{}, {}, {}", sum(&|one| one.used), sum(&|one| one.rejected), sum(&|one| one.wrong)),
        ),
        (
            "position in a used frame, rms across and along the beam, mm",
            format!("{:.3}, {:.3}", root(|one| one.squares, 0), root(|one| one.squares, 1)),
        ),
        (
            "the curve through them, rms across and along the beam, mm",
            format!("{:.3}, {:.3}", root(|one| one.of_curve, 0), root(|one| one.of_curve, 1)),
        ),
        (
            "its normalised squared error, across and along",
            format!("{:.2}, {:.2}", mean(&|one| one.normalised[0]), mean(&|one| one.normalised[1])),
        ),
        ("lag, rms error, s", format!("{:.4}", mean(&|one| one.lag_error_s.powi(2)).sqrt())),
        (
            "K where the sweep's start is stated 0.1 mm too deep, mean (least to most)",
            format!(
                "{:+.2} % ({:+.2} to {:+.2})",
                mean(&shifted),
                all.iter().map(shifted).fold(f64::INFINITY, f64::min),
                all.iter().map(shifted).fold(f64::NEG_INFINITY, f64::max)
            ),
        ),
    ];
    let rows: Vec<String> = rows.iter().map(|(what, value)| format!("| {what} | {value} |")).collect();
    format!("| K from frames of the simulated scanner | {count} runs |\n|---|---|\n{}", rows.join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_counts_what_intervals_hold() {
        let modulus = |k_kpa: f64, half: f64| Modulus { k_kpa, interval_kpa: [k_kpa - half, k_kpa + half] };
        let one = |k_kpa: f64| Imaged {
            true_kpa: 10.0,
            of_images: modulus(k_kpa, 0.2),
            of_truth: modulus(10.0, 0.16),
            of_numbers: modulus(10.0, 0.4),
            of_shifted: modulus(1.01 * k_kpa, 0.2),
            used: 100,
            rejected: 5,
            wrong: 0,
            squares: [1e-4, 4e-4],
            normalised: [1.0, 0.9],
            of_curve: [4e-4, 9e-4],
            lag_error_s: 0.001,
        };
        let table = table(&[one(10.1), one(10.3)]);
        for row in [
            "images | 1 of 2",
            "1.25 (1.25)",
            "0.50 (0.50)",
            "200, 10, 0",
            "0.010, 0.020",
            "0.020, 0.030",
            "+1.00 %",
        ] {
            assert!(table.contains(row), "{row}\n{table}");
        }
    }
}
