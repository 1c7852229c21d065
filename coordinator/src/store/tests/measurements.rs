use super::{StoreError, empty, reopened, run};
use crate::store::StoredMeasurement;

fn kept(id: &str, title: &str, note: &str) -> StoredMeasurement {
    StoredMeasurement {
        number: 0,
        id: id.to_owned(),
        kept_unix_ms: 7,
        owner: "alice".to_owned(),
        title: title.to_owned(),
        note: note.to_owned(),
        source: "white.csv".to_owned(),
        command: String::new(),
        dictionary: "lab".to_owned(),
        materials: "white\ncyan".to_owned(),
        channels: 6,
    }
}

/// A measurement that is kept again is the newest, with its title and note unless new ones are given.
#[tokio::test]
async fn measurement_kept_again_is_the_newest() {
    let (_dir, store) = empty().await;
    store.keep_measurement(&kept("a", "", "first"), b"1").await.unwrap();
    store.keep_measurement(&kept("b", "second", ""), b"2").await.unwrap();
    // Two people who change title and note at once lose nothing.
    store.annotate_measurement("a", Some("first print"), None).await.unwrap();
    store.annotate_measurement("a", None, Some("slab 2\nscratched")).await.unwrap();
    store.keep_measurement(&kept("a", "", ""), b"3").await.unwrap();
    let all = store.measurements_before(i64::MAX, 10).await.unwrap();
    let shown: Vec<_> = all.iter().map(|m| (m.id.as_str(), m.title.as_str(), m.note.as_str())).collect();
    assert_eq!(shown, [("a", "first print", "slab 2\nscratched"), ("b", "second", "")]);
    assert_eq!(store.measurements_before(all[0].number, 10).await.unwrap(), all[1..]);
    assert_eq!(store.measurement_with_content("a").await.unwrap(), Some((all[0].clone(), b"3".to_vec())));
    store.keep_measurement(&kept("c", "", ""), b"").await.unwrap();
    assert_eq!(store.measurement("c").await.unwrap().unwrap().title, "white, cyan");
    assert_eq!(store.measurements_of("alice").await.unwrap(), (3, 2));
    store.delete_measurement("a").await.unwrap();
    assert_eq!(store.measurement_content("a").await.unwrap(), None);
}

/// Measurements are still there after a restart; one whose content was damaged is an error, the others can be read.
#[tokio::test]
async fn damaged_measurements_are_found() {
    let (dir, store) = empty().await;
    store.keep_measurement(&kept("a", "", ""), b"content of a").await.unwrap();
    store.keep_measurement(&kept("b", "", ""), b"content of b").await.unwrap();
    run(&store, "UPDATE measurements SET content = x'00' WHERE id = 'a'").await;
    let store = reopened(store, &dir).await;
    assert_eq!(store.damaged_measurements().await.unwrap(), ["a"]);
    let error = store.measurement_content("a").await.unwrap_err();
    assert!(matches!(error, StoreError::Corrupt { table: "measurements", row: 1, .. }), "{error}");
    assert_eq!(store.measurement_content("b").await.unwrap().as_deref(), Some(&b"content of b"[..]));
}
