//! Tests a profile's quadratic and its noise, with numbers that can be checked by hand.

use super::*;

/// One shared unknown and one of the profile's own: the information [[5, 2], [2, 4]], and a pull of (3, 2).
fn reduced() -> Reduced {
    let information = DMatrix::from_row_slice(2, 2, &[5.0, 2.0, 2.0, 4.0]);
    Reduced::new(Quadratic { downhill: DVector::from_row_slice(&[3.0, 2.0]), information }, 1)
}

/// The least cost lies at (1/2, 1/4), 2 below that of the start; the covariance is the inverse of the information.
#[test]
fn own_unknowns_are_eliminated_exactly() {
    let reduced = reduced();
    assert_eq!((reduced.information[(0, 0)], reduced.downhill[0]), (4.0, 2.0));
    let shared = DVector::from_element(1, 0.5);
    let own = reduced.own_step(&shared);
    assert_eq!((own[0], reduced.own_response(&shared)[0]), (0.25, -0.25));
    assert_eq!((reduced.fall(&shared, &own), reduced.own_decrement()), (2.0, 1.0));
    let covariance = DMatrix::from_element(1, 1, 0.25);
    assert_eq!(reduced.own_covariance(&covariance)[(0, 0)], 5.0 / 16.0);
}

/// Damping by 3 makes the own information 16. The predicted fall of a step is that of the actual cost, not of the damped
/// one.
#[test]
fn damped_steps_promise_the_undamped_fall() {
    let damped = reduced().damped(3.0);
    assert_eq!((damped.information[(0, 0)], damped.downhill[0]), (4.75, 2.75));
    let [shared, own] = [0.5, 0.25].map(|step| DVector::from_element(1, step));
    assert_eq!(damped.fall(&shared, &own), 2.0);
}

/// Two pixels with standard errors of 3, and a gain that is not exact.
fn term() -> Term {
    let x_mm = vec![-0.5, 0.5];
    Term {
        blend: None,
        thickness_mm: 1.0,
        camera: Camera::new(&x_mm, 1.0, 2.0, 2),
        x_mm,
        values: vec![1.0; 2],
        std_errors: vec![3.0; 2],
        origin_mm: 0.0,
        priors: vec![OwnPrior { own: Own::Gain, std_error: 0.1, slab_std_error: 0.0 }],
        modes: Vec::new(),
        rest_variances: Vec::new(),
        alike: 1.0,
        left_out: vec![false; 2],
        robust: false,
        softness: 1.0,
        near: None,
        white: None,
        by_wedge: vec![0.0; 2],
        responses: None,
    }
}

/// The noise of four profiles with the same records has four times the variance; the contribution of the modes to the
/// model is unchanged.
#[test]
fn alike_profiles_multiply_the_noise() {
    let mut term = term();
    (term.modes, term.rest_variances) = (vec![vec![1.0, -2.0]], vec![4.0, 0.0]);
    let mut own = vec![0.5, 3.0];
    term.count_alike(&mut own, 4.0);
    assert_eq!((&term.modes, &term.rest_variances), (&vec![vec![2.0, -4.0]], &vec![16.0, 0.0]));
    assert_eq!((own[0], own[1]), (0.5, 1.5));
    assert_eq!([0, 1].map(|pixel| term.deviation(pixel)), [5.0, 3.0]);
    term.count_alike(&mut own, 1.0);
    assert_eq!((&term.modes, own[1]), (&vec![vec![1.0, -2.0]], 3.0));
}

/// Pixels that are left out have no weight, and residuals count in units of the softened noise.
#[test]
fn weights_follow_dust_and_softness() {
    let mut term = term();
    let linear = Linear { residuals: vec![8.0, 8.0], model: vec![], columns: vec![], cost: 0.0 };
    term.left_out = vec![true, false];
    assert_eq!(term.weights(&linear), [0.0, 1.0]);
    (term.robust, term.softness) = (true, 4.0);
    assert_eq!(term.weights(&linear), [0.0, weight(2.0)]);
}
