//! The answers as tables for people (Markdown), and one line each for spreadsheets (CSV).

use std::path::Path;

use farm_tests::statistics::{Share, quantile};
use optics_model::fit::Objective;

use super::outcome::{COVERED, Outcome, QUANTITIES, Way};
use super::rows::Row;

/// Errors and coverage of every row, fitted in one way.
pub(super) fn imperfections(rows: &[Row], outcomes: &[Outcome], way: Way) -> String {
    let mut text = format!("\n{}, g {}\n\n", way.objective_name(), way.g_name());
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
        let told: Vec<f64> = these.iter().filter_map(|o| o.probability).collect();
        let improbable = Share::of(told.iter().map(|p| *p < 0.01));
        text += &improbable.map_or("| – |\n".to_owned(), |s| format!("| {:.1} |\n", 100.0 * s.share));
    }
    text
}

/// Median and 90 % of the sizes of errors, in per cent.
fn spread(outcomes: &[&Outcome], which: usize) -> String {
    let sizes: Vec<f64> = outcomes.iter().map(|o| 100.0 * o.errors()[which].abs()).collect();
    format!("{:.2} / {:.2}", quantile(sizes.clone(), 0.5), quantile(sizes, 0.9))
}

/// Widths of the intervals over the Cramér–Rao bound where nothing is wrong; none if the likelihood did not answer.
pub(super) fn efficiency(rows: &[Row], outcomes: &[Outcome]) -> Option<String> {
    let row = rows.iter().position(|row| row.name == "none")?;
    outcomes.iter().find(|o| o.row == row && o.bound.is_some())?;
    let mut text = "\n| objective | g | quantity | width over the bound, median / 90 % | closed | hold |\n\
                    |---|---|---|---|---|---|\n"
        .to_owned();
    for way in Way::ALL {
        let these: Vec<&Outcome> = outcomes.iter().filter(|o| o.row == row && o.way == way).collect();
        for (q, name) in QUANTITIES.into_iter().enumerate() {
            let ratios = widths(&these, outcomes, q);
            if ratios.is_empty() {
                continue;
            }
            let (median, most) = (quantile(ratios.clone(), 0.5), quantile(ratios.clone(), 0.9));
            let (objective, g) = (way.objective_name(), way.g_name());
            let (closed, held) = (ratios.len(), Share::of(these.iter().map(|o| o.holds(q))).unwrap());
            text +=
                &format!("| {objective} | {g} | {name} | {median:.2} / {most:.2} | {closed} | {held} |\n");
        }
    }
    Some(text)
}

/// Each over the bound that the likelihood tells for the same data.
fn widths(these: &[&Outcome], all: &[Outcome], quantity: usize) -> Vec<f64> {
    let ratio = |o: &&Outcome| {
        let way = Way { objective: Objective::Likelihood, ..o.way };
        let told = all.iter().find(|l| l.row == o.row && l.subject == o.subject && l.way == way)?;
        o.over_bound(quantity, told.bound.as_ref()?)
    };
    these.iter().filter_map(ratio).collect()
}

/// One line for each medium, row and way.
pub(super) fn write_csv(file: &Path, rows: &[Row], outcomes: &[Outcome]) {
    let mut writer = csv::Writer::from_path(file).unwrap();
    let mut heads = ["row", "objective", "g_mode", "medium", "resolved", "misfit", "probability", "outliers"]
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
        o.way.objective_name().to_owned(),
        o.way.g_name().to_owned(),
        o.subject.to_string(),
        o.resolved.to_string(),
        o.misfit.to_string(),
        o.probability.map_or_else(String::new, |p| p.to_string()),
        o.outliers.to_string(),
    ];
    for (q, interval) in o.intervals.iter().enumerate() {
        let bound = o.bound.as_ref().map(|bound| bound[q]);
        let end = |end: Option<f64>| end.map_or_else(String::new, |v| v.to_string());
        fields.extend([o.truth[q], o.found[q], interval.low, interval.high].map(|v| v.to_string()));
        fields.extend([interval.open_low, interval.open_high].map(|v| v.to_string()));
        fields.extend([end(bound.map(|b| b.low)), end(bound.map(|b| b.high))]);
    }
    fields
}
