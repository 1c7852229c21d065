//! Computes functions of angles with the same bits on every machine.

/// sin² of an angle in degrees, by a series that gives the same bits on every machine.
pub fn sin2(degrees: f64) -> f64 {
    if degrees > 45.0 {
        return 1.0 - sin2(90.0 - degrees);
    }
    let x = degrees.to_radians();
    // x ≤ π/4: the terms fall below 1e-17 of the sum after 9 of them.
    let (mut term, mut sum) = (x, x);
    for k in 1..10 {
        term *= -x * x / f64::from(2 * k * (2 * k + 1));
        sum += term;
    }
    sum * sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sin2_agrees_with_the_library() {
        for i in 0..=900 {
            let degrees = f64::from(i) / 10.0;
            assert!((sin2(degrees) - libm::sin(degrees.to_radians()).powi(2)).abs() < 1e-15, "{degrees}");
        }
    }
}
