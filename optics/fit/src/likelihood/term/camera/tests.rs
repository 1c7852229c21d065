use super::*;

const PIXELS: usize = 360;
const WIDTH_MM: f64 = 10.0;

fn x(pixels: usize, shift: f64) -> Line {
    let pitch = WIDTH_MM / pixels as f64;
    (0..pixels).map(|i| (i as f64 + 0.5) * pitch - 0.5 * WIDTH_MM + shift).collect()
}

/// Averages over pixels of a step that is blurred by a Gaussian of the standard deviation w.
fn edge(pixels: usize, origin: f64, w: f64) -> Line {
    let pitch = WIDTH_MM / pixels as f64;
    // ∫ erf = t erf(t) + exp(−t²)/√π
    let integral = |x: f64| {
        let t = (x - origin) / (w * 2.0_f64.sqrt());
        w * 2.0_f64.sqrt() * (t * libm::erf(t) + libm::exp(-t * t) / PI.sqrt())
    };
    x(pixels, 0.0)
        .iter()
        .map(|x| 0.5 + 0.4 * (integral(x + 0.5 * pitch) - integral(x - 0.5 * pitch)) / pitch)
        .collect()
}

fn largest(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// With the same pixels and no shift, the camera returns the profile unchanged.
#[test]
fn identical_pixels_keep_the_profile() {
    let camera = Camera::new(&x(PIXELS, 0.0), WIDTH_MM / 360.0, WIDTH_MM, PIXELS);
    let profile = edge(PIXELS, 0.0, 0.1);
    let seen = camera.values(&profile, 0.0, 0.0);
    assert!(largest(&seen, &profile) < 1e-12);
}

/// Shift, blur and resampling match the formula within the error bound of six-point interpolation.
#[test]
fn shift_blur_and_resampling_match_the_formula() {
    let profile = edge(PIXELS, 0.0, 0.12);
    for (pixels, origin, blur) in [(360, 0.011, 0.0), (360, -0.07, 0.03), (180, 0.2, 0.025), (500, 0.0, 0.1)]
    {
        let camera = Camera::new(&x(pixels, 0.0), WIDTH_MM / pixels as f64, WIDTH_MM, PIXELS);
        let seen = camera.values(&profile, origin, blur * blur);
        let exact = edge(pixels, origin, libm::hypot(0.12_f64, blur));
        let off = largest(&seen, &exact);
        // With six nodes an integral is off by at most 17/720 h⁶ of its sixth derivative, beside the edge between
        // black and white, at either end of a pixel.
        let (h, w) = (WIDTH_MM / PIXELS as f64, libm::hypot(0.12_f64, blur));
        let fifth = 3.0 * 0.8 / (2.0 * PI).sqrt() / w.powi(5);
        let bound = 2.0 * 17.0 / 720.0 * h.powi(6) * fifth * pixels as f64 / WIDTH_MM;
        // The completion at the edge counts fifth derivatives as a step: Σ w_k (2k + 1)⁵/1,920 of them, of which a
        // blurred pixel has at most 1/60.
        let sharp = 3.0 * 0.8 / (2.0 * PI).sqrt() / 0.12_f64.powi(5);
        let bound = bound + if blur > 0.0 { 4875.0 / 1920.0 * h.powi(5) * sharp / 60.0 } else { 0.0 };
        assert!(off < bound, "{pixels} pixels, origin {origin}, blur {blur}: {off} {bound}");
    }
}

/// A step, as thin slabs show it, is as sharp in a shifted picture as in the dictionary's.
#[test]
fn steps_stay_sharp_between_pixels() {
    let stepped = |pixels: usize, origin: f64| -> Line {
        let pitch = WIDTH_MM / pixels as f64;
        let light = |x: f64| (x - origin + 0.5 * pitch).clamp(0.0, pitch) / pitch;
        x(pixels, 0.0).iter().zip(edge(pixels, origin, 0.5)).map(|(x, e)| e + 0.3 * light(*x)).collect()
    };
    for (pixels, origin) in [(360, 0.011), (360, -0.05), (180, 0.15), (500, 0.0)] {
        let camera = Camera::new(&x(pixels, 0.0), WIDTH_MM / pixels as f64, WIDTH_MM, PIXELS);
        let seen = camera.values(&stepped(PIXELS, 0.0), origin, 0.0);
        let off = largest(&seen, &stepped(pixels, origin));
        assert!(off < 1e-5, "{pixels} pixels, origin {origin}: {off}");
    }
}

/// The derivatives by origin and blur match difference quotients.
#[test]
fn derivatives_match_difference_quotients() {
    let profile = edge(PIXELS, 0.0, 0.12);
    let camera = Camera::new(&x(180, 0.003), WIDTH_MM / 180.0, WIDTH_MM, PIXELS);
    let (origin, blur, step) = (0.013, 0.0009, 1e-5);
    let seen = camera.expose(&profile, std::slice::from_ref(&profile), origin, blur);
    assert!(largest(&seen.slopes[0], &seen.values) < NEGLIGIBLE);
    let quotient = |above: Line, below: Line, step: f64| -> Line {
        above.iter().zip(&below).map(|(a, b)| (a - b) / step).collect()
    };
    let at = |origin, blur| camera.values(&profile, origin, blur);
    let by_origin = quotient(at(origin + step, blur), at(origin - step, blur), 2.0 * step);
    assert!(largest(&by_origin, &seen.by_origin) < 1e-5);
    let by_blur = quotient(at(origin, blur + step), at(origin, blur - step), 2.0 * step);
    assert!(largest(&by_blur, &seen.by_blur) < 1e-3 * 20.0);
}

/// Without a blur, derivatives need one tap; for a lens of 36 µm on pixels of 28 µm, a third of them.
#[test]
fn derivatives_need_few_taps() {
    for (variance, least, most) in [(0.0, 1, 1), (1.3 * 1.3, 4, 11)] {
        let kernel = BlurKernel::new(variance);
        let taps = kernel.main_taps();
        assert!((least..=most).contains(&taps.len()), "{variance}: {}", taps.len());
        let sum = 2.0 * taps.iter().sum::<f64>() - taps[0];
        assert!((sum - 1.0).abs() < NEGLIGIBLE, "{variance}: {sum}");
    }
}

/// Beyond its ends a profile continues in a straight line.
#[test]
fn profile_continues_in_a_straight_line() {
    let line: Line = (0..PIXELS).map(|i| 0.3 + 0.001 * i as f64).collect();
    let padded = pad(&line);
    assert!(padded.windows(2).all(|w| (w[1] - w[0] - 0.001).abs() < 1e-12));
}
