//! Converts leases and jobs.

use super::mirror::required;
use crate::ids::{DictionaryId, Token};
use crate::lease::{HeldLease, Lease, LeaseKey, job_identity};
use crate::wire;
use optics_model::grid::Walks;
use optics_model::invalid::{Invalid, Result};
use optics_model::job::JobSpec;
use optics_model::medium::TransportPoint;
use optics_model::scene::Scene;

impl From<LeaseKey> for wire::LeaseKey {
    fn from(key: LeaseKey) -> Self {
        let LeaseKey { dictionary, job, attempt, token, part } = key;
        Self { dictionary_id: dictionary.0, job, attempt, token: token.to_string(), part }
    }
}

impl From<wire::LeaseKey> for LeaseKey {
    fn from(key: wire::LeaseKey) -> Self {
        let dictionary = DictionaryId(key.dictionary_id);
        Self {
            dictionary,
            job: key.job,
            attempt: key.attempt,
            token: Token::parse(&key.token),
            part: key.part,
        }
    }
}

impl From<HeldLease> for wire::HeldLease {
    fn from(lease: HeldLease) -> Self {
        let HeldLease { key, running, identity } = lease;
        Self { key: Some(key.into()), running, identity: identity.as_bytes().to_vec() }
    }
}

impl TryFrom<wire::HeldLease> for HeldLease {
    type Error = Invalid;

    fn try_from(lease: wire::HeldLease) -> Result<Self> {
        let key = LeaseKey::from(required("key", lease.key)?);
        Ok(Self { key, running: lease.running, identity: job_identity(&lease.identity)? })
    }
}

impl From<&JobSpec> for wire::JobSpec {
    fn from(job: &JobSpec) -> Self {
        Self {
            scene: Some(job.scene().into()),
            point: Some(job.point().into()),
            albedo: job.albedo().to_vec(),
            walks: job.walks().get(),
            seed: job.seed(),
            derivatives: job.derivatives(),
            first_record: job.first_record() as u32,
            block: job.block(),
            identity: job.identity().as_bytes().to_vec(),
        }
    }
}

impl TryFrom<wire::JobSpec> for JobSpec {
    type Error = Invalid;

    fn try_from(job: wire::JobSpec) -> Result<Self> {
        let scene = Scene::try_from(required("scene", job.scene)?).map_err(|e| e.within("scene"))?;
        let point = TransportPoint::try_from(required("point", job.point)?).map_err(|e| e.within("point"))?;
        let walks = Walks::new(job.walks)?;
        let whole = Self::new(scene, point, job.albedo, walks, job.seed, job.derivatives)?
            .numbered_from(job.first_record as usize);
        match job.block {
            Some(block) => whole.with_block(block),
            None => Ok(whole),
        }
    }
}

impl From<Lease> for wire::Lease {
    fn from(lease: Lease) -> Self {
        Self { key: Some(lease.key.into()), job: Some((&lease.job).into()) }
    }
}

impl TryFrom<wire::Lease> for Lease {
    type Error = Invalid;

    fn try_from(lease: wire::Lease) -> Result<Self> {
        let key = LeaseKey::from(required("key", lease.key)?);
        let job = JobSpec::try_from(required("job", lease.job)?).map_err(|e| e.within("job"))?;
        Ok(Self { key, job })
    }
}
