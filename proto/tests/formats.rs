//! Checks that messages that programs of every version have sent can be read.
//!
//! Versions are named by the schema of their database. A message of the newest one must have exactly the bytes that
//! this program sends, so that another number or type of a field is detected.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use farm_proto::ids::Token;
use farm_proto::lease::Lease;
use farm_proto::status::{DictionaryState, DictionaryStatus};
use farm_proto::wire::complete_request::Content;
use farm_proto::{PROTOCOL_VERSION, wire};
use optics_model::fit::{Common, FitOptions, MaterialFit, ScaleCurve};
use optics_model::job::JobSpec;
use optics_model::{Digest, Grid, MeasuredProfile, Measurement, Profile, Record};
use prost::Message;

const VERSIONS: std::ops::RangeInclusive<u32> = 1..=NEWEST;
const NEWEST: u32 = 6;
/// Version of the physics in each version.
const PHYSICS_VERSIONS: [u32; 6] = [2, 3, 3, 3, 3, 3];

/// The messages of a file, which are separated by empty lines.
fn encoded(version: u32, name: &str) -> Vec<Vec<u8>> {
    let file = format!("{}/../tests/data/formats/{version}/{name}.hex", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(&file).unwrap_or_else(|error| panic!("{file}: {error}"));
    let decode = |message: &str| {
        let digits: Vec<u8> = message.bytes().filter(u8::is_ascii_hexdigit).collect();
        let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
        digits.chunks(2).map(byte).collect()
    };
    text.split("\n\n").map(decode).collect()
}

fn messages<M: Message + Default>(version: u32, name: &str) -> Vec<M> {
    encoded(version, name).iter().map(|bytes| M::decode(&bytes[..]).unwrap()).collect()
}

/// The only message of a file. If it is of the newest version, `again` encodes it again from the decoded value.
fn message<M: Message + Default, T>(
    version: u32,
    name: &str,
    understand: impl Fn(M) -> T,
    again: impl Fn(&T) -> M,
) -> T {
    let understood = understand(messages(version, name).remove(0));
    if version == NEWEST {
        assert_eq!(again(&understood).encode_to_vec(), encoded(version, name)[0], "{name}");
    }
    understood
}

fn grid(version: u32) -> Grid {
    let understand = |request: wire::SubmitRequest| Grid::try_from(request.grid.unwrap()).unwrap();
    let submit = |grid| wire::SubmitRequest { name: "tiny".to_owned(), grid: Some(grid), priority: 0 };
    message(version, "submit_request", understand, |grid: &Grid| submit(grid.into()))
}

/// A grid is read equally from the messages of every version.
#[test]
fn grid_is_equal_in_every_version() {
    for version in VERSIONS {
        assert_eq!(grid(version), grid(NEWEST), "version {version}");
        let mut hasher = blake3::Hasher::new_derive_key("farm.v1 grid");
        hasher.update(&PHYSICS_VERSIONS[version as usize - 1].to_le_bytes());
        hasher.update(&wire::Grid::from(&grid(version)).encode_to_vec());
        let digest = Digest::from_bytes(hasher.finalize().into()).to_string();
        let status = messages::<wire::Dictionary>(version, "dictionary").remove(0);
        assert_eq!(status.grid_digest, digest, "version {version}");
    }
}

#[test]
fn status_of_a_dictionary_is_understood() {
    for version in VERSIONS {
        let understand = |status: wire::Dictionary| DictionaryStatus::try_from(status).unwrap();
        let status = message(version, "dictionary", understand, |status| status.into());
        let found = (status.state, status.jobs_done, status.records_done(), status.records_digest.is_some());
        assert_eq!(found, (DictionaryState::Done, 3, 9, true), "version {version}");
        // Fields that the first version did not have.
        assert_eq!((status.priority, status.eta_s, status.goes_first), (0, None, None), "version {version}");
        let owner = if version >= 5 { "alice" } else { "" };
        let found = (status.jobs_disputed, &status.owner[..]);
        assert_eq!(found, (usize::from(version >= 4), owner), "version {version}");
    }
}

/// The digest that a job's only record had up to physics version 5, when standard errors were floats.
fn digest_of_floats(record: &Record) -> Digest {
    let mut hasher = blake3::Hasher::new_derive_key("farm.v1 records");
    hasher.update(&(record.index as u64).to_le_bytes());
    for estimate in record.profiles.iter().flat_map(Profile::estimates) {
        for number in [estimate.values(), estimate.std_errors()].into_iter().flatten() {
            hasher.update(&number.to_le_bytes());
        }
    }
    Digest::from_bytes(hasher.finalize().into())
}

#[test]
fn exported_record_with_derivatives_is_understood() {
    for version in VERSIONS {
        let understand = |record: wire::Record| Record::try_from(record).unwrap();
        let record = message(version, "records", understand, |record| record.clone().into());
        assert!(record.profiles.iter().all(|profile| profile.derivatives.is_some()), "version {version}");
        let digest = Digest::of_jobs([digest_of_floats(&record)]).to_string();
        assert_eq!(digest, "e055f3e4960318c9b5d568cdde3e97e0a16d22a2f871f97b8cf2ff86cebcb44f");
    }
}

#[test]
fn question_for_a_fit_is_understood() {
    for version in VERSIONS {
        let (measurement, options) = message(
            version,
            "fit_request",
            |request: wire::FitRequest| {
                let measurement = Measurement::try_from(request.measurement.unwrap()).unwrap();
                (measurement, request.options.unwrap())
            },
            |(measurement, options)| {
                let (measurement, options) = (Some(measurement.into()), Some(options.clone()));
                wire::FitRequest { dictionary: "tiny".to_owned(), measurement, options }
            },
        );
        let channels: Vec<&str> = measurement.profiles().iter().map(MeasuredProfile::channel).collect();
        assert_eq!(channels, ["R", "G"], "version {version}");
        let options = FitOptions::try_from(options).unwrap();
        assert!(options.settings().refine && options.settings().curves, "version {version}");
        assert_eq!(options.settings().top, 2, "version {version}");
    }
}

#[test]
fn answer_of_a_fit_is_understood() {
    for version in VERSIONS {
        let understand = |answer: wire::FitResponse| MaterialFit::try_from(answer.fit.unwrap()).unwrap();
        let again = |fit: &MaterialFit| wire::FitResponse { fit: Some(fit.clone().into()) };
        let fit = message(version, "fit_response", understand, again);
        assert_eq!((&fit.material[..], fit.channels.len()), ("white", 2), "version {version}");
        for channel in &fit.channels {
            assert_eq!((channel.candidates.len(), channel.curves.len()), (2, 1), "version {version}");
            let best = &channel.candidates[0];
            assert!(best.error.is_finite() && best.thicknesses[0].record.is_some(), "version {version}");
            let refined = channel.refined.as_ref().unwrap();
            assert!(refined.sigma_t_per_mm.low <= refined.sigma_t_per_mm.high, "version {version}");
            assert!(version >= 3 || refined.suspicion.is_none(), "version {version} had none");
        }
    }
}

/// Release 0.2 called a medium resolved if it was resolved at its g, and had no field for that: the field is set if the
/// medium is resolved.
#[test]
fn release_0_2_answer_is_resolved() {
    let [fit]: [wire::FitResponse; 1] = messages(6, "fit_response_0.2").try_into().unwrap();
    let [measured]: [wire::MeasureResponse; 1] = messages(6, "measure_response_0.2").try_into().unwrap();
    let media: Vec<MaterialFit> =
        fit.fit.into_iter().chain(measured.materials).map(|fit| fit.try_into().unwrap()).collect();
    let channels = media.iter().flat_map(|material| &material.channels);
    let flags: Vec<(bool, bool)> =
        channels.map(|c| c.refined.as_ref().unwrap()).map(|r| (r.resolved, r.resolved_at_g)).collect();
    assert_eq!(flags, [(true, true), (false, false), (true, true), (true, true)]);
}

/// The answer of a measurement: scale, media, and their common quantities.
type Measured = (Option<ScaleCurve>, (f64, f64, Option<f64>), Vec<MaterialFit>, Option<Common>);

#[test]
fn answer_of_a_measurement_is_understood() {
    for version in VERSIONS {
        let (scale, (mu, _, g), materials, common): Measured = message(
            version,
            "measure_response",
            |r: wire::MeasureResponse| {
                let materials: Vec<MaterialFit> =
                    r.materials.into_iter().map(|fit| fit.try_into().unwrap()).collect();
                let scale = r.scale.map(|scale| scale.try_into().unwrap());
                (scale, (r.mu, r.mu_std_error, r.g), materials, r.common.map(|c| c.try_into().unwrap()))
            },
            |(scale, (mu, mu_std_error, g), materials, common)| {
                let (mu, mu_std_error, g, scale) = (*mu, *mu_std_error, *g, scale.clone().map(Into::into));
                let materials = materials.iter().cloned().map(Into::into).collect();
                let common = common.clone().map(Into::into);
                wire::MeasureResponse { scale, mu, mu_std_error, g, materials, common, ..Default::default() }
            },
        );
        assert_eq!(scale.unwrap().points.len(), 5, "version {version}");
        assert!((0.8..=1.2).contains(&mu) && g == Some(0.3), "version {version}: {mu}, {g:?}");
        assert_eq!(materials[0].channels.len(), 2, "version {version}");
        assert_eq!(common.is_some(), version >= 3, "version {version}");
    }
}

/// Workers have the coordinator's version: older ones send no version of the protocol, and are refused.
#[test]
fn older_worker_protocol_is_recognised() {
    let register = |version| messages::<wire::RegisterRequest>(version, "register_request").remove(0);
    for version in 1..3 {
        let request = register(version);
        assert_eq!((&request.label[..], request.threads), ("by hand", 2), "version {version}");
        assert_ne!(request.protocol_version, PROTOCOL_VERSION, "version {version}");
    }
    for version in 3..=NEWEST {
        assert_eq!(register(version).protocol_version, PROTOCOL_VERSION, "version {version}");
    }
    assert_eq!((&register(3).host[..], &register(NEWEST).host[..]), ("", "host"));
    // It sent records as messages, which this version does not accept.
    let requests = messages::<wire::CompleteRequest>(2, "complete_requests");
    assert!(matches!(requests[0].content, Some(Content::Header(_))));
    assert_eq!(requests[1].content, None);
}

#[test]
fn lease_is_understood() {
    // The identity depends on the physics version of the program that wrote the message.
    let sent = messages::<wire::AcquireResponse>(NEWEST, "acquire_response").remove(0).leases.remove(0);
    let identity = sent.job.unwrap().identity;
    let lease = message(
        NEWEST,
        "acquire_response",
        |response: wire::AcquireResponse| {
            let [lease] = <[wire::Lease; 1]>::try_from(response.leases).unwrap();
            assert_eq!(lease.job.as_ref().unwrap().identity.len(), 32);
            Lease::try_from(lease).unwrap()
        },
        |lease| {
            let mut lease = wire::Lease::from(lease.clone());
            lease.job.as_mut().unwrap().identity.clone_from(&identity);
            wire::AcquireResponse { leases: vec![lease], drain: false }
        },
    );
    assert_eq!((lease.key.attempt, lease.key.part), (1, lease.job.block().unwrap()));
    let of_grid = JobSpec::of(&grid(NEWEST), lease.key.job as usize);
    assert_eq!((lease.job.point(), lease.job.albedo()), (of_grid.point(), of_grid.albedo()));
    assert_eq!(lease.job.first_record(), of_grid.first_record());
}

#[test]
fn stream_of_results_is_understood() {
    let requests = messages::<wire::CompleteRequest>(NEWEST, "complete_requests");
    let again: Vec<Vec<u8>> = requests.iter().map(Message::encode_to_vec).collect();
    assert_eq!(again, encoded(NEWEST, "complete_requests"));
    let contents: Vec<Content> = requests.into_iter().map(|r| r.content.unwrap()).collect();
    let [
        Content::Header(first),
        Content::Records(a),
        Content::Records(b),
        Content::Header(second),
        Content::Sums(sums),
    ] = &contents[..]
    else {
        panic!("{contents:?}")
    };
    for header in [first, second] {
        assert_eq!(header.identity.len(), 32);
        assert_ne!(Token::parse(&header.key.as_ref().unwrap().token).to_string(), "");
    }
    assert_eq!((first.key.as_ref().unwrap().part, second.key.as_ref().unwrap().part), (0, 1));
    // The pieces are those of the exported record.
    let record = Record::try_from(messages::<wire::Record>(NEWEST, "records").remove(0)).unwrap();
    let mut bytes = Vec::new();
    record.extend_le_bytes(&mut bytes);
    assert_eq!([&a[..], &b[..]].concat(), bytes);
    let numbers: Vec<f64> = sums.chunks(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!(numbers, (1..=12).map(|i| f64::from(i) / 8.0).collect::<Vec<_>>());
}
