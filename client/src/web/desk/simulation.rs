//! Simulates a slab in the scene of a grid, without its records.

use anyhow::{Context, Result, bail};
use optics_model::job::JobSpec;
use optics_model::{Grid, Invalid, Medium, TransportPoint, Walks};

use super::api::{SimulateRequest, SimulateResponse, SimulatedChannel};
use crate::traced::traced;

/// Number of walks if none is given, and the largest.
const WALKS: u64 = 50_000;
const MOST_WALKS: u64 = 1_000_000;
/// Not that of usual dictionaries, so that the simulation is independent of their records.
const SEED: u64 = 20_171_127;

pub(super) fn simulate(request: SimulateRequest) -> Result<SimulateResponse> {
    let (Some(grid), Some(medium)) = (request.grid, request.medium) else {
        bail!(Invalid::new("grid", "nothing", "a grid and a medium are needed"))
    };
    let grid = Grid::try_from(grid).map_err(|e| e.within("grid"))?;
    let medium = Medium::try_from(medium).map_err(|e| e.within("medium"))?;
    let walks = if request.walks == 0 { WALKS } else { request.walks };
    if walks > MOST_WALKS {
        bail!(Invalid::new("walks", walks, format!("at most {MOST_WALKS} are allowed")));
    }
    let point =
        TransportPoint::new(medium.sigma_t_per_mm(), medium.g(), request.thickness_mm, request.sample_ior)?;
    let scene = grid.scene().clone();
    let job = JobSpec::new(scene, point, vec![medium.albedo()], Walks::new(walks)?, SEED, false)?;
    let record = traced(&job)?.pop().context("the tracer returned no record")?;
    let numbers = |all: &[f32]| all.iter().copied().map(f64::from).collect();
    let channels = grid.scene().channels().iter().zip(&record.profiles);
    let channels = channels.map(|(channel, profile)| SimulatedChannel {
        channel: channel.name().to_owned(),
        values: numbers(profile.radiance_factor.values()),
        std_errors: numbers(profile.radiance_factor.std_errors()),
    });
    Ok(SimulateResponse { channels: channels.collect(), walks })
}
