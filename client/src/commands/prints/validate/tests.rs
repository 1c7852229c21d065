use super::*;

/// A patch of two channels with errors of 1 % each, of a gain of 1 %, and of a medium of 1 %.
fn patch(number: usize, difference: [f64; 2]) -> Vec<PatchJson> {
    let channel = |difference: f64| PatchJson {
        material: "white".to_owned(),
        thickness_mm: 1.0,
        channel: "R".to_owned(),
        measured: 1.0 + difference,
        predicted: 1.0,
        expected_std_error: 0.0,
        z: 0.0,
        parts: DifferenceParts {
            own: 0.01,
            shared: vec![(ErrorKey::Gain(number), 0.01), (ErrorKey::Shared(0), 0.01)],
        },
    };
    difference.map(channel).into()
}

/// By hand: of the sum the variance is 2 + 2·4, of the difference 2; χ² is s²/10 + d²/2, halved for unit vectors.
#[test]
fn common_errors_count_once_per_patch() {
    for [a, b] in [[1.0, 1.0], [1.0, -1.0], [2.0, 0.5]] {
        let expected = (a + b) * (a + b) / 10.0 + (a - b) * (a - b) / 2.0;
        let found = chi2(&[patch(0, [0.01 * a, 0.01 * b])]);
        assert!((found - expected).abs() < 1e-9, "{found} {expected}");
    }
    assert_eq!(chi2(&[]), 0.0);
}

/// Two patches with the same difference: the variance of the sum of all four is 4 + 2·4 + 16, that of the difference of
/// both patches 4 + 2·4.
#[test]
fn patches_share_the_errors_of_media() {
    for sign in [1.0, -1.0] {
        let found = chi2(&[patch(0, [0.01; 2]), patch(1, [0.01 * sign; 2])]);
        let expected = 16.0 / if sign > 0.0 { 28.0 } else { 12.0 };
        assert!((found - expected).abs() < 1e-9, "{found} {expected}");
    }
}

/// Two patches: the medium's error is common to both, their own gains are not.
#[test]
fn inks_share_their_error_over_patches() {
    let slab = NamedSlab { shares: vec![("white".to_owned(), 1.0)], thickness_mm: 1.0 };
    let patches = [1.0, 2.0].map(|mm| ChartPatch {
        material: "white",
        slab: NamedSlab { thickness_mm: mm, ..slab.clone() },
        values: Vec::new(),
    });
    let found = ink("white", &patches, &[patch(0, [0.01; 2]), patch(1, [0.01; 2])]);
    // Variances in 1e-4: own 4, gains 2 · 4, the medium 16.
    assert!((found.z - 4.0 / 28_f64.sqrt()).abs() < 1e-9 && found.patches == 2, "{found:?}");
}
