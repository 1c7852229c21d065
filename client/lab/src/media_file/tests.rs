use farm_figures::testing;
use serde_json::json;

use super::*;

fn media() -> MediaFile {
    let channels = ["R", "G"].map(|name| testing::channel(name, 6.0, 1.0)).into();
    let fits = [MaterialFit { material: "white".into(), channels }];
    let scene = Scene::lab();
    let digest = Digest::of_bytes(b"grid");
    let variances = [0, 1, 2].map(|i| fits[0].channels[0].refined.as_ref().unwrap().covariance[i][i]);
    let of_medium = [0.5 * variances[0].sqrt(), 0.0, 0.0, 0.01, 0.0];
    let difference = |prior, material| SetUpDifference {
        prior,
        material,
        channel: None,
        difference: 0.01,
        changes: vec![0.0, 0.005],
    };
    let errors = SharedErrors {
        sources: 2,
        media: vec![of_medium, [0.0; 5], of_medium, [0.0; 5]],
        scene: vec![difference(0, Some(0)), difference(1, None)],
    };
    let with = MeasuredWith { dictionary: "lab", digest, scene: &scene, mu: [1.0, 0.01] };
    MediaFile::new(&fits, &errors, &with)
}

/// Programs write whole numbers without a point, as browsers do.
#[test]
fn whole_numbers_of_media_are_read() {
    let text = media().text().unwrap().replace(".0,", ",").replace(".0\n", "\n");
    let read = MediaFile::from_json(serde_json::from_str(&text).unwrap()).unwrap();
    assert_eq!(read, media());
}

/// A file is read as it was written, from its folder, too; the scene keeps its uncertain numbers.
#[test]
fn media_files_survive() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(MEDIA_FILE);
    std::fs::write(&path, media().text().unwrap()).unwrap();
    for path in [folder.path(), &path] {
        let read = MediaFile::read(path).unwrap();
        assert_eq!(read, media());
        assert_eq!(Scene::try_from(read.scene).unwrap(), Scene::lab());
    }
}

/// Refusals name the file, and the material where it is a number.
#[test]
fn wrong_media_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let is_refused = |text: &str, message: &str| {
        std::fs::write(folder.path().join(MEDIA_FILE), text).unwrap();
        let refused = format!("{:#}", MediaFile::read(folder.path()).unwrap_err());
        assert!(refused.contains(message), "{refused}");
    };
    is_refused("{}", "its format is null, not \"farmctl-media/1\"");
    let empty = json!({"material": "white", "channels": []});
    for (place, value, message) in [
        ("/materials/0/channels/0/sigma_t_per_mm", json!(-6.0), "white R: sigma_t_per_mm = -6 is not valid"),
        ("/materials/0/channels/0/sample_ior", json!(0.5), "sample_ior = 0.5 is not valid"),
        ("/materials/0/channels/0/covariance/0/0", json!(-1.0), "a symmetric matrix of finite variances"),
        (
            "/materials/0/channels/0/shared",
            json!([[0.0, 0.0, 0.0, 0.0, 0.0]]),
            "media.json: white R: shared = 1 changes is not valid: 2 changes are needed",
        ),
        ("/set_up/1/shared", json!([0.0]), "set_up coat roughness: it has 1 shared errors, others 2"),
        ("/materials", json!([empty, empty]), "occurs twice"),
    ] {
        let mut wrong = serde_json::to_value(media()).unwrap();
        *wrong.pointer_mut(place).unwrap() = value;
        is_refused(&wrong.to_string(), message);
    }
    std::fs::remove_file(folder.path().join(MEDIA_FILE)).unwrap();
    let missing = format!("{:#}", MediaFile::read(folder.path()).unwrap_err());
    assert!(missing.contains("`farmctl measure` writes it into the session's folder"), "{missing}");
    let named = media().material("cyan").unwrap_err().to_string();
    assert_eq!(named, "material \"cyan\" is not in the file: it has white");
}
