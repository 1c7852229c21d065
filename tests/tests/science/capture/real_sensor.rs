//! A real sensor's photograph: openISP's test picture (github.com/cruxopen/openISP, `raw/test.RAW`), 1920 × 1080 pixels
//! of a chart with slanted squares, ten bits RGGB in steps of four. It is not part of the repository:
//! `FARM_TEST_OPENISP` names the file.

use std::path::Path;

use optics_capture::{Colour, Darks, Frame, Levels, Pattern, Photo, Refusal, check_shot, find_edges};

const WIDTH: usize = 1920;
const HEIGHT: usize = 1080;
const FULL: f64 = 1020.0;
/// The file has no black level, and no edge depends on it. One step, since 0 would count as already subtracted.
const BLACK: f64 = 4.0;

/// Rise from 10 to 90 % of a step convolved with a Gaussian, in σ.
const RISE: f64 = 2.563_1;

/// Columns and rows.
type Area = [[usize; 2]; 2];

const WHOLE: Area = [[0, WIDTH], [0, HEIGHT]];

/// An edge of the slanted square in the chart's middle.
struct Edge {
    area: Area,
    /// 0 runs up and down, 1 across.
    run: usize,
    /// From an independent implementation of ISO 12233 (half-way crossings of each row, a straight line through them,
    /// medians in bins of a quarter of a pixel), accurate to 0.02° and 0.1 px.
    angle_deg: f64,
    rise_px: f64,
}

const SQUARE: [Edge; 4] = [
    Edge { area: [[760, 880], [496, 640]], run: 0, angle_deg: -6.713, rise_px: 2.32 },
    Edge { area: [[960, 1080], [480, 620]], run: 0, angle_deg: -6.653, rise_px: 2.52 },
    Edge { area: [[836, 990], [420, 510]], run: 1, angle_deg: -6.637, rise_px: 2.32 },
    Edge { area: [[856, 1000], [600, 690]], run: 1, angle_deg: -6.748, rise_px: 2.24 },
];

fn part(file: &Path, [columns, rows]: Area) -> Photo {
    let bytes = std::fs::read(file).expect("the photograph is there");
    assert_eq!(bytes.len(), 2 * WIDTH * HEIGHT, "{}", file.display());
    let samples: Vec<u16> = bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
    let row = |y: usize| samples[y * WIDTH..][columns[0]..columns[1]].to_vec();
    let samples = (rows[0]..rows[1]).flat_map(row).collect();
    // Rows and columns begin at even numbers, so that the mosaic does not change.
    let pattern = Pattern::Bayer([Colour::Red, Colour::Green, Colour::Green, Colour::Blue]);
    Photo {
        label: "openisp".to_owned(),
        frame: Frame::new(columns[1] - columns[0], rows[1] - rows[0], pattern, samples)
            .expect("parts are large enough"),
        levels: Levels { black: Some([BLACK; 4]), white: Some([FULL; 4]) },
        seconds: None,
        exposure: None,
    }
}

/// The photograph is refused since it clips. The edges of its slanted square have the right angle and rise.
#[test]
#[ignore = "needs a photograph: FARM_TEST_OPENISP"]
fn real_sensor_clipping_is_detected() {
    let file = std::env::var_os("FARM_TEST_OPENISP").expect("FARM_TEST_OPENISP names openISP's test.RAW");
    let refusal = check_shot(&part(file.as_ref(), WHOLE), Darks::new()).unwrap_err();
    println!("{refusal}");
    assert!(matches!(refusal, Refusal::Clipped { .. }), "{refusal}");
    for expected in &SQUARE {
        let found = find_edges(&part(file.as_ref(), expected.area)).unwrap()[expected.run].unwrap();
        let (angle_deg, rise_px) = (found.angle_deg, RISE * found.blur_px.unwrap().value);
        println!("{:.3}° ± {:.3}°, rise {rise_px:.2} px", angle_deg.value, angle_deg.std_error);
        assert!(
            (angle_deg.value - expected.angle_deg).abs() < 0.03,
            "{angle_deg:?} for {}°",
            expected.angle_deg
        );
        assert!((rise_px - expected.rise_px).abs() < 0.25, "{rise_px} for {} px", expected.rise_px);
    }
}
