//! The paper's five materials, photographed with a wrong exposure.

use farm_tests::coverage::{Answer, Coverage, media_table};
use farm_tests::statistics::effort;
use optics_fit::{measure, scale};
use optics_model::Medium;
use optics_model::fit::{FitOptions, MuRange};

use super::{dictionary, materials, print_common, unknown_factor};

/// A material and its σ_t and α in R, G, B.
pub(super) type Row = (&'static str, [(f64, f64); 3]);

/// The paper's Table 1, at g = 0.4.
pub(super) const TABLE_1: [Row; 5] = [
    ("cyan", [(9.0, 0.05), (4.5, 0.7), (7.5, 0.98)]),
    ("magenta", [(2.5, 0.98), (3.0, 0.1), (10.0, 0.9)]),
    ("yellow", [(2.25, 0.997), (3.75, 0.995), (19.0, 0.15)]),
    ("black", [(5.0, 0.35), (5.5, 0.35), (6.5, 0.35)]),
    ("white", [(6.0, 0.9991), (9.0, 0.9997), (24.0, 0.999)]),
];

/// Table 1 of the paper is measured with a scale factor that the fit does not get; with three in the long form.
#[test]
fn table_1_is_measured_without_its_factor() {
    let media = TABLE_1.map(|(_, media)| media.map(|(s, a)| Medium::new(s, a, 0.4).unwrap()));
    let (options, range) = (FitOptions::default(), MuRange::default());
    let mut answers = Vec::new();
    for (hidden, seed) in [(0.86, 1), (0.913, 2), (0.98, 3)].into_iter().take(effort().min(3) as usize) {
        let names = TABLE_1.iter().map(|row| row.0);
        let slabs = materials(names.zip(media), seed * 100, 1_000_000, hidden);
        let found = measure(dictionary(), &slabs, &options, &unknown_factor()).unwrap();
        let common = &found.common;
        print!("hidden {hidden}: ");
        print_common(common);
        // The truth lies on the grid here, where the best records have no error except noise. Refined errors do not
        // assume that, so they are checked against their own standard error.
        let off = (common.mu - hidden).abs();
        assert!(off <= 3.0 * common.mu_std_error && off <= 0.015, "{common:?}");
        let by_records = scale(dictionary(), &slabs, &options, &range).unwrap().best.mu;
        assert!((by_records - hidden).abs() <= 0.005, "{by_records}");
        let g = common.g.unwrap();
        assert!((g - 0.4).abs() < 0.06 && common.g_interval.unwrap().contains(0.4), "{common:?}");
        let of_factor = Answer::all(&found.materials, media.as_flattened());
        println!("{}", media_table(&of_factor, &[0, 1]));
        for (i, answer) in of_factor.iter().enumerate() {
            let is_resolved = answer.json["resolved_at_g"] == true;
            // Cyan's red and yellow's blue are not resolved. With relative noise, magenta's green can be measured,
            // although it is dark.
            assert!(i == 4 || is_resolved != matches!(i, 0 | 8), "{answer:?}");
            assert!(!is_resolved || answer.medium[0].error().abs() < 0.1, "{answer:?}");
        }
        answers.extend(of_factor);
    }
    // 30 intervals of 95 % for each factor, with the same μ and g; unresolved media must have the same coverage.
    let found = Coverage::of_media([&answers[..]], &[0, 1]);
    let (held, count) = (found.count(), found.all().count());
    println!("{held} of {count} intervals hold");
    assert!(held * 10 >= count * 9, "{held} of {count}");
}
