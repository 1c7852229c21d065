//! A real sensor's photograph: openISP's test picture (github.com/cruxopen/openISP, `raw/test.RAW`), 1920 × 1080 pixels of
//! a chart with slanted squares, ten bits RGGB in steps of four. It is not copied here: `FARM_TEST_OPENISP` names it.

use std::path::Path;

use optics_capture::{Colour, Frame, Levels, Pattern, Photo, Refusal, check_shot, find_edges};

const WIDTH: usize = 1920;
const HEIGHT: usize = 1080;
const FULL: f64 = 1020.0;

/// 10 to 90 % of a step behind a Gaussian, in σ.
const RISE: f64 = 2.563_1;

/// Columns and rows: all of the picture, and the left edge of the square in its middle.
const WHOLE: [[usize; 2]; 2] = [[0, WIDTH], [0, HEIGHT]];
const EDGE: [[usize; 2]; 2] = [[760, 880], [496, 640]];

fn part(file: &Path, [columns, rows]: [[usize; 2]; 2]) -> Photo {
    let bytes = std::fs::read(file).unwrap();
    assert_eq!(bytes.len(), 2 * WIDTH * HEIGHT, "{}", file.display());
    let samples: Vec<u16> = bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
    let row = |y: usize| samples[y * WIDTH..][columns[0]..columns[1]].to_vec();
    let samples = (rows[0]..rows[1]).flat_map(row).collect();
    // Rows and columns begin at even numbers, so that the mosaic stays what it is.
    let pattern = Pattern::Bayer([Colour::Red, Colour::Green, Colour::Green, Colour::Blue]);
    Photo {
        label: "openisp".to_owned(),
        frame: Frame::new(columns[1] - columns[0], rows[1] - rows[0], pattern, samples).unwrap(),
        levels: Levels { black: Some([0.0; 4]), white: Some(FULL) },
        seconds: None,
        exposure: None,
    }
}

#[test]
#[ignore = "needs a photograph: FARM_TEST_OPENISP"]
fn a_real_photograph_that_clips_is_refused_and_its_slanted_edge_has_the_known_angle_and_rise() {
    let file = std::env::var_os("FARM_TEST_OPENISP").expect("FARM_TEST_OPENISP names openISP's test.RAW");
    let refusal = check_shot(&part(file.as_ref(), WHOLE)).unwrap_err();
    println!("{refusal}");
    assert!(matches!(refusal, Refusal::Clipped { .. }), "{refusal}");
    let edge = find_edges(&part(file.as_ref(), EDGE)).unwrap()[0].unwrap();
    let (angle_deg, blur_px) = (edge.angle_deg, edge.blur_px.unwrap());
    let rise_px = RISE * blur_px.value;
    println!("{edge:?}, rise {rise_px:.2} px");
    assert!((angle_deg.value.abs() - 7.1).abs() < 0.03, "{angle_deg:?}");
    assert!((rise_px - 2.7).abs() < 0.1, "{rise_px}");
}
