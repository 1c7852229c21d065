//! Tests that open checks survive a restart.

use super::*;

fn claim(by: Option<i64>, byte: u8) -> Claim {
    Claim { by: by.map(Origin), digest: Digest::from_bytes([byte; 32]) }
}

/// Open checks survive a restart unchanged, with their claims.
#[tokio::test]
async fn open_checks_survive_a_restart() {
    let (dir, store) = empty().await;
    for name in ["a", "b"] {
        store.register_worker(&Machine::at(name), name).await.unwrap();
    }
    let d = dictionary(&store).await;
    let dictionary = d.id;
    let check = |job, block, claims: &[Claim]| OpenCheck { dictionary, job, block, claims: claims.to_vec() };
    let disputed = check(1, 0, &[claim(None, 1), claim(Some(2), 2)]);
    let of_block = check(1, 7, &[claim(Some(1), 3)]);
    for noted in [&check(1, 0, &[claim(None, 1)]), &disputed, &of_block, &check(0, 0, &[claim(Some(1), 4)])] {
        store.note_check(noted).await.unwrap();
    }
    store.note_check(&check(0, 0, &[])).await.unwrap();
    let gone = OpenCheck { dictionary: DictionaryId(99), ..disputed.clone() };
    store.note_check(&gone).await.unwrap();
    let store = reopened(store, &dir).await;
    assert_eq!(store.open_checks().await.unwrap(), [disputed, of_block]);
    delete(&store, d.id).await;
    assert!(store.open_checks().await.unwrap().is_empty());
}
