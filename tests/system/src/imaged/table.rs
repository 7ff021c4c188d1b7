//! The table of `cargo xtask study images`.

use super::{Imaged, Modulus};

/// Table of all runs together.
pub(super) fn table(all: &[Imaged]) -> String {
    let count = all.len();
    let rows = [
        (
            "true K in the interval of K from images",
            format!("{} of {count}", all.iter().filter(|one| one.of_images.holds(one.true_kpa)).count()),
        ),
        (
            "K from the true shape in the interval of K from images",
            format!(
                "{} of {count}",
                all.iter().filter(|one| one.of_images.holds(one.of_truth.k_kpa)).count()
            ),
        ),
        (
            "error of K, rms: images; true shape; shape as numbers, 0.025 mm a point",
            format!(
                "{:.2} %; {:.2} %; {:.2} %",
                error(|one| &one.of_images, count, all),
                error(|one| &one.of_truth, count, all),
                error(|one| &one.of_numbers, count, all)
            ),
        ),
        (
            "the same in stated standard deviations: images; shape as numbers",
            format!(
                "{:.2}; {:.2}",
                stated_width(|one| &one.of_images, count, all),
                stated_width(|one| &one.of_numbers, count, all)
            ),
        ),
        (
            "interval beside that from the true shape, mean (largest)",
            format!("{:.2} ({:.2})", mean(&beside_truth, count, all), most(&beside_truth, all)),
        ),
        (
            "interval beside that from the shape as numbers, mean (largest)",
            format!("{:.2} ({:.2})", mean(&beside_numbers, count, all), most(&beside_numbers, all)),
        ),
        (
            "frames: used, rejected, used though they show something else",
            format!(
                "{}, {}, {}",
                sum(&|one| one.used, all),
                sum(&|one| one.rejected, all),
                sum(&|one| one.wrong, all)
            ),
        ),
        (
            "position in a used frame, rms across and along the beam, mm",
            format!(
                "{:.3}, {:.3}",
                root_mean(|one| one.squares, 0, count, all),
                root_mean(|one| one.squares, 1, count, all)
            ),
        ),
        (
            "the curve through them, rms across and along the beam, mm",
            format!(
                "{:.3}, {:.3}",
                root_mean(|one| one.of_curve, 0, count, all),
                root_mean(|one| one.of_curve, 1, count, all)
            ),
        ),
        (
            "its normalised squared error, across and along",
            format!(
                "{:.2}, {:.2}",
                mean(&|one| one.normalised[0], count, all),
                mean(&|one| one.normalised[1], count, all)
            ),
        ),
        ("lag, rms error, s", format!("{:.4}", mean(&|one| one.lag_error_s.powi(2), count, all).sqrt())),
        (
            "K where the sweep's start is stated 0.1 mm too deep, mean (least to most)",
            format!(
                "{:+.2} % ({:+.2} to {:+.2})",
                mean(&shifted_percent, count, all),
                all.iter().map(shifted_percent).fold(f64::INFINITY, f64::min),
                all.iter().map(shifted_percent).fold(f64::NEG_INFINITY, f64::max)
            ),
        ),
    ];
    let rows: Vec<String> = rows.iter().map(|(what, value)| format!("| {what} | {value} |")).collect();
    format!("| K from frames of the simulated scanner | {count} runs |\n|---|---|\n{}", rows.join("\n"))
}

fn stated_width(modulus: fn(&Imaged) -> &Modulus, count: usize, all: &[Imaged]) -> f64 {
    mean(&|one| modulus(one).off_sd(one.true_kpa).powi(2), count, all).sqrt()
}

fn root_mean(squares: fn(&Imaged) -> [f64; 2], axis: usize, count: usize, all: &[Imaged]) -> f64 {
    mean(&|one| squares(one)[axis], count, all).sqrt()
}

fn shifted_percent(one: &Imaged) -> f64 {
    100.0 * (one.of_shifted.k_kpa / one.of_images.k_kpa - 1.0)
}

fn sum(value: &dyn Fn(&Imaged) -> usize, all: &[Imaged]) -> usize {
    all.iter().map(value).sum::<usize>()
}

fn beside_numbers(one: &Imaged) -> f64 {
    one.of_images.width_kpa() / one.of_numbers.width_kpa()
}

fn beside_truth(one: &Imaged) -> f64 {
    one.of_images.width_kpa() / one.of_truth.width_kpa()
}

fn error(modulus: fn(&Imaged) -> &Modulus, count: usize, all: &[Imaged]) -> f64 {
    100.0 * mean(&|one| (modulus(one).k_kpa / one.true_kpa - 1.0).powi(2), count, all).sqrt()
}

fn most(value: &dyn Fn(&Imaged) -> f64, all: &[Imaged]) -> f64 {
    all.iter().map(value).fold(0.0, f64::max)
}

fn mean(value: &dyn Fn(&Imaged) -> f64, count: usize, all: &[Imaged]) -> f64 {
    all.iter().map(value).sum::<f64>() / count.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_counts_what_intervals_hold() {
        let table = table(&[imaged(10.1), imaged(10.3)]);
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

    fn imaged(k_kpa: f64) -> Imaged {
        Imaged {
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
        }
    }

    fn modulus(k_kpa: f64, half: f64) -> Modulus {
        Modulus { k_kpa, interval_kpa: [k_kpa - half, k_kpa + half] }
    }
}
