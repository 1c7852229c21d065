//! Requests whose content would harm a coordinator: decompression bombs and invalid names.

use farm_proto::wire::{FitRequest, Layer, ListRequest, MeasuredProfile, Measurement, SubmitRequest};
use farm_tests::farm::Farm;
use farm_tests::usage::Usage;
use optics_model::Grid;
use tonic::Code;
use tonic_types::StatusExt as _;

/// Messages that would grow a hundredfold are refused before they are decoded.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn expanding_message_is_not_decoded() {
    let farm = Farm::start(&[]);
    let profiles = vec![MeasuredProfile::default(); 4 << 20];
    let measurement = Measurement { material: "white".to_owned(), profiles };
    let request =
        FitRequest { dictionary: "paper".to_owned(), measurement: Some(measurement), options: None };
    let before = Usage::of(farm.coordinator().id()).unwrap();
    let refused = farm.fits().fit(request).await.unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted, "{refused}");
    let grown_mib = (Usage::of(farm.coordinator().id()).unwrap().peak_kib - before.peak_kib) >> 10;
    assert!(grown_mib < 100, "{grown_mib} MiB");
}

/// A name that is too long or not printable is refused with its field, and lists still work.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn names_have_a_length_and_are_printable() {
    let farm = Farm::start(&[]);
    for name in ["x".repeat(8 << 20), "board\u{1b}[2J".to_owned(), "\u{202e}draob".to_owned()] {
        let mut grid = farm_proto::wire::Grid::from(&Grid::paper());
        let layers: &mut Vec<Layer> = &mut grid.scene.as_mut().unwrap().layers;
        let field = format!("grid.scene.layers[{}].name", layers.len() - 1);
        layers.last_mut().unwrap().name = name;
        let request = SubmitRequest { name: "trouble".to_owned(), grid: Some(grid), priority: 1000 };
        let refused = farm.dictionaries().submit(request).await.unwrap_err();
        assert_eq!(refused.code(), Code::InvalidArgument, "{refused}");
        let named = refused.get_details_bad_request().unwrap().field_violations.remove(0).field;
        assert_eq!(named, field);
    }
    let listed = farm.dictionaries().list(ListRequest::default()).await.unwrap().into_inner();
    assert!(listed.dictionaries.is_empty());
}
