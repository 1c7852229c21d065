//! Formats the outcomes as Markdown tables, and as one CSV line each.

use std::path::Path;

use farm_tests::statistics::{Share, quantile};

use super::outcome::{COVERED, Outcome, QUANTITIES, Way};
use super::rows::Row;

/// Errors and coverage of every row for one way to fit.
pub(super) fn imperfections(rows: &[Row], outcomes: &[Outcome], way: Way) -> String {
    let mut text = format!("\ng {}\n\n", way.g_name());
    text += "| imperfection | media | σ_t %, median / 90 % | 1 − α %, median / 90 % ";
    text += "| hold σ_t | α | σ_s(1−g) | σ_a | unresolved % | misfit > 2 % | p(χ²) < 1 % % |\n";
    text += &format!("{}|\n", "|---".repeat(11));
    for (number, row) in rows.iter().enumerate() {
        let these: Vec<&Outcome> = outcomes.iter().filter(|o| o.row == number && o.way == way).collect();
        if these.is_empty() {
            continue;
        }
        let share = |ok: &dyn Fn(&Outcome) -> bool| Share::of(these.iter().map(|o| ok(o))).unwrap();
        text += &format!("| {} | {} | {} | {} ", row.name, these.len(), spread(&these, 0), spread(&these, 1));
        text += &COVERED.map(|q| format!("| {} ", share(&|o| o.holds(q)))).concat();
        let (unresolved, misfit) = (share(&|o| !o.resolved), share(&Outcome::is_misfit));
        text += &format!("| {:.1} | {:.1} ", 100.0 * unresolved.share, 100.0 * misfit.share);
        text += &format!("| {:.1} |\n", 100.0 * share(&|o| o.probability < 0.01).share);
    }
    text
}

/// Median and 90 % of the sizes of errors, in per cent.
fn spread(outcomes: &[&Outcome], which: usize) -> String {
    let sizes: Vec<f64> = outcomes.iter().map(|o| 100.0 * o.errors()[which].abs()).collect();
    format!("{:.2} / {:.2}", quantile(sizes.clone(), 0.5), quantile(sizes, 0.9))
}

/// Ratio of the widths of intervals to the Cramér–Rao bound without imperfections; None without such a row.
pub(super) fn efficiency(rows: &[Row], outcomes: &[Outcome]) -> Option<String> {
    let row = rows.iter().position(|row| row.name == "none")?;
    outcomes.iter().find(|o| o.row == row)?;
    let mut text = "\n| g | quantity | width over the bound, median / 90 % | closed | hold |\n\
                    |---|---|---|---|---|\n"
        .to_owned();
    for way in Way::ALL {
        let these: Vec<&Outcome> = outcomes.iter().filter(|o| o.row == row && o.way == way).collect();
        for (q, name) in QUANTITIES.into_iter().enumerate() {
            let ratios = widths(&these, q);
            if ratios.is_empty() {
                continue;
            }
            let (median, most) = (quantile(ratios.clone(), 0.5), quantile(ratios.clone(), 0.9));
            let g = way.g_name();
            let (closed, held) = (ratios.len(), Share::of(these.iter().map(|o| o.holds(q))).unwrap());
            text += &format!("| {g} | {name} | {median:.2} / {most:.2} | {closed} | {held} |\n");
        }
    }
    Some(text)
}

/// Ratios to the bound of the same data.
fn widths(these: &[&Outcome], quantity: usize) -> Vec<f64> {
    these.iter().filter_map(|o| o.over_bound(quantity, &o.bound)).collect()
}

/// Writes one line per medium, row and way.
pub(super) fn write_csv(file: &Path, rows: &[Row], outcomes: &[Outcome]) {
    let mut writer = csv::Writer::from_path(file).unwrap();
    let mut heads = ["row", "g_mode", "medium", "resolved", "misfit", "probability", "outliers"]
        .map(str::to_owned)
        .to_vec();
    for name in ["sigma_t_per_mm", "albedo", "g", "reduced_scattering_per_mm", "absorption_per_mm"] {
        let columns = ["true", "found", "low", "high", "open_low", "open_high", "bound_low", "bound_high"];
        heads.extend(columns.map(|column| format!("{name}_{column}")));
    }
    writer.write_record(heads).unwrap();
    for outcome in outcomes {
        writer.write_record(line(&rows[outcome.row], outcome)).unwrap();
    }
    writer.flush().unwrap();
}

fn line(row: &Row, o: &Outcome) -> Vec<String> {
    let mut fields = vec![
        row.name.clone(),
        o.way.g_name().to_owned(),
        o.subject.to_string(),
        o.resolved.to_string(),
        o.misfit.to_string(),
        o.probability.to_string(),
        o.outliers.to_string(),
    ];
    for (q, interval) in o.intervals.iter().enumerate() {
        fields.extend([o.truth[q], o.found[q], interval.low, interval.high].map(|v| v.to_string()));
        fields.extend([interval.open_low, interval.open_high].map(|v| v.to_string()));
        fields.extend([o.bound[q].low, o.bound[q].high].map(|v| v.to_string()));
    }
    fields
}

#[cfg(test)]
mod tests {
    use super::*;
    use optics_model::fit::{Ends, Interval};

    /// σ_t = 2, found as 2.1, with an interval of a given half-width about it.
    fn outcome(way: Way, half: f64, bound: f64) -> Outcome {
        let (truth, found) = ([2.0, 0.9, 0.4, 1.08, 0.2], [2.1, 0.9, 0.4, 1.08, 0.2]);
        let about = |v: f64, half: f64| (v - half, v + half);
        let interval = |v: f64| {
            let (low, high) = about(v, half);
            Interval { low, high, open_low: false, open_high: false }
        };
        let ends = |half: f64| found.map(|v| about(v, half)).map(|(low, high)| Ends { low, high });
        Outcome {
            row: 0,
            way,
            subject: 5,
            truth,
            found,
            intervals: found.map(interval),
            bound: ends(bound),
            resolved: true,
            misfit: 1.0,
            probability: 0.3,
            outliers: 0,
        }
    }

    /// Widths of intervals are given relative to the bound of the same data.
    #[test]
    fn interval_widths_are_compared_with_the_bound() {
        let [held, free] = Way::ALL;
        let rows = [Row::named("none")];
        let found = [outcome(free, 0.15, 0.05), outcome(held, 0.06, 0.05)];
        let text = efficiency(&rows, &found).unwrap();
        assert!(text.contains("| free | σ_t | 3.00 / 3.00 | 1 | 100.0 ± 0.0 |"), "{text}");
        assert!(text.contains("| held | σ_t | 1.20 / 1.20 | 1 | 0.0 ± 0.0 |"), "{text}");
        assert_eq!(efficiency(&rows, &[]), None);
    }

    /// A row has errors, coverage and verdicts.
    #[test]
    fn row_has_errors_coverage_and_verdicts() {
        let held = Way::ALL[0];
        let found = [outcome(held, 0.15, 0.1), outcome(held, 0.05, 0.1)];
        let text = imperfections(&[Row::named("none")], &found, held);
        let line = "| none | 2 | 5.00 / 5.00 | 0.00 / 0.00 | 50.0 ± 35.4 | 100.0 ± 0.0 | 100.0 ± 0.0 \
                    | 100.0 ± 0.0 | 0.0 | 0.0 | 0.0 |";
        assert!(text.contains(line), "{text}");
    }

    /// The CSV file has a line for each answer.
    #[test]
    fn csv_has_a_line_per_answer() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("answers.csv");
        let found = [outcome(Way::ALL[0], 0.15, 0.1), outcome(Way::ALL[1], 0.15, 0.1)];
        write_csv(&file, &[Row::named("none")], &found);
        let text = std::fs::read_to_string(file).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 3);
        assert!(lines[0].starts_with("row,g_mode,medium") && lines[2].starts_with("none,free,5,"));
        assert!(lines.iter().all(|line| line.split(',').count() == 47), "{text}");
    }
}
