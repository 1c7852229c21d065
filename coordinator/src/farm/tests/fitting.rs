//! Tests the memory for dictionaries that are used in fits, and questions whose answer is no longer awaited.

use std::time::Duration;

use optics_fit::FitChannel;
use optics_model::fit::FitOptions;
use optics_model::{MeasuredProfile, Measurement};

use super::*;

/// A farm with a dictionary that is done, and memory for this many of its channels.
async fn with_room_for(channels: usize) -> (Arc<Farm>, TempDir) {
    let (farm, dir) = done().await;
    let mut farm = Arc::into_inner(farm).expect("no other handle of the farm");
    farm.fits = crate::farm::FitCache::new(channels * FitChannel::bytes_of(&grid(), 0));
    (Arc::new(farm), dir)
}

/// The channels of the dictionary that a question about some channels receives.
async fn met(farm: &Farm, names: &[&str]) -> Result<Vec<usize>, FarmError> {
    let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
    let question = |d: &optics_fit::FitDictionary| Ok(d.channels().map(|(index, _)| index).collect());
    farm.ask(&name(), (&names, Vec::new()), question).await
}

/// If there is no room for all channels, a fit reads its own only, and those that are in memory are not read again.
#[tokio::test]
async fn recent_channels_stay_in_memory() {
    let (farm, dir) = with_room_for(2).await;
    assert_eq!(met(&farm, &["G"]).await.unwrap(), [1]);
    assert_eq!(met(&farm, &["R", "G"]).await.unwrap(), [0, 1]);
    // The green channel was used last, so it is in memory; blue takes red's place.
    assert_eq!(met(&farm, &["G"]).await.unwrap(), [1]);
    assert_eq!(met(&farm, &["B"]).await.unwrap(), [2]);
    change(&dir, "DELETE FROM records").await;
    assert_eq!(met(&farm, &["G", "B"]).await.unwrap(), [1, 2], "both are in memory");
    assert!(matches!(met(&farm, &["R"]).await, Err(FarmError::Damaged { .. })), "red is read again");
}

/// A dictionary that fits into memory is read as a whole, and refuses a question over boards other than its own.
#[tokio::test]
async fn dictionary_that_fits_is_read_whole() {
    let (farm, dir) = with_room_for(3).await;
    assert_eq!(met(&farm, &["G"]).await.unwrap(), [0, 1, 2]);
    change(&dir, "DELETE FROM records").await;
    for channel in ["R", "G", "B"] {
        assert!(!met(&farm, &[channel]).await.unwrap().is_empty());
    }
    let board = optics_model::scene::Channel::new("R", 0.95, 0.02).unwrap();
    let refused = farm.ask(&name(), (&[], vec![board]), |_| Ok(())).await.unwrap_err();
    assert!(matches!(&refused, FarmError::Invalid(invalid) if invalid.field() == "board"), "{refused:?}");
}

/// A fit beyond the memory limit is refused. The message gives the number of channels and the option that sets the limit.
#[tokio::test]
async fn fit_beyond_the_memory_limit_is_refused() {
    let (farm, _dir) = with_room_for(2).await;
    let refused = met(&farm, &["R", "G", "B"]).await.unwrap_err();
    assert!(matches!(refused, FarmError::TooLarge { channels: 3, .. }), "{refused:?}");
    let text = refused.to_string();
    assert!(text.contains("3 of its channels") && text.contains("--fit-memory"), "{text}");
    assert_eq!(met(&farm, &["R", "B"]).await.unwrap(), [0, 2]);
}

/// A question whose answer is no longer awaited is stopped, so that others get the cores.
#[tokio::test]
async fn abandoned_question_ends() {
    let (farm, _dir) = with_room_for(3).await;
    let (begun, has_begun) = tokio::sync::oneshot::channel();
    let (left, ended) = tokio::sync::oneshot::channel::<()>();
    let question = move |d: &optics_fit::FitDictionary| {
        // Dropped when the question ends, in whatever way.
        let _left = left;
        let numbers = |from: f64, step: f64| (0..16).map(|i| from + step * f64::from(i)).collect();
        let (x, values) = (numbers(-4.6875, 0.625), numbers(0.2, 0.01));
        let profile = MeasuredProfile::new("G", 1.0, x, values, None).unwrap();
        let measurement = Measurement::new("m", vec![profile]).unwrap();
        let fit = || optics_fit::fit(d, &measurement, &FitOptions::default()).unwrap();
        begun.send(fit()).unwrap();
        // Minutes of work, but no endless loop: the runtime waits for work that has begun.
        (0..100_000).for_each(|_| drop(fit()));
        Ok(())
    };
    let asking = async move { farm.ask::<()>(&name(), (&["G".to_owned()], Vec::new()), question).await };
    let asked = tokio::spawn(asking);
    has_begun.await.unwrap();
    asked.abort();
    assert!(asked.await.unwrap_err().is_cancelled());
    assert!(tokio::time::timeout(Duration::from_mins(1), ended).await.unwrap().is_err());
}
