use std::io::Write;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result};
use farm_proto::job::JobSpec;
use farm_proto::scene::{Channel, Scene, Sensor};
use farm_proto::{Invalid, Medium, Profile, TransportPoint, Walks};
use farm_worker::tracer;
use serde::Serialize;

use crate::cli::SimulateArgs;
use crate::figures;
use crate::grid_file::read_scene;
use crate::output::{Output, envelope};
use crate::plot::Picture;

pub(crate) async fn run(args: SimulateArgs, output: &Output) -> Result<()> {
    let job = job(&args)?;
    let scene = job.scene().clone();
    let mut pool = rayon::ThreadPoolBuilder::new();
    if let Some(threads) = args.threads {
        pool = pool.num_threads(usize::from(threads));
    }
    let pool = pool.build().context("starting the tracing threads")?;
    if let Some(path) = &args.plot {
        Picture::check_path(path)?;
        if !(args.change > 0.0 && args.change < 1.0) {
            return Err(Invalid::new("change", args.change, "allowed are numbers above 0, below 1").into());
        }
    }
    let medium = Medium::new(args.sigma_t, args.albedo, args.g)?;
    let (plot, change) = (args.plot.is_some(), args.change);
    let work = move || {
        let records = tracer::trace(&job, &AtomicBool::new(false))?;
        let picture = plot.then(|| figures::changes(&job, &medium, change)).transpose()?;
        anyhow::Ok((records, picture))
    };
    let traced = tokio::task::spawn_blocking(move || pool.install(work));
    let (records, picture) = traced.await.context("the tracer")??;
    if let (Some(picture), Some(path)) = (picture, &args.plot) {
        picture.write(path)?;
    }
    let profiles = &records.first().context("the tracer gave no record")?.profiles;
    if output.is_json() {
        let channels = scene.channels().iter().zip(profiles).map(|(c, p)| ChannelJson::new(c, p)).collect();
        let x_mm = (0..scene.sensor().pixels()).map(|i| scene.sensor().centre_mm(i)).collect();
        let data = SimulateJson { x_mm, walks: args.walks, seed: args.seed, channels };
        writeln!(std::io::stdout().lock(), "{}", envelope("simulate", &data)?)?;
        return Ok(());
    }
    write_csv(&scene, profiles)
}

fn job(args: &SimulateArgs) -> Result<JobSpec> {
    let medium = Medium::new(args.sigma_t, args.albedo, args.g)?;
    let point = TransportPoint::new(medium.sigma_t_per_mm(), medium.g(), args.thickness, args.sample_ior)?;
    let mut scene = read_scene(&args.scene)?;
    if let (Some(light), Some(dark)) = (args.rho_light, args.rho_dark) {
        scene = scene.with_channels(vec![Channel::new("mono", light, dark)?])?;
    }
    let sensor = scene.sensor();
    let width = args.width.unwrap_or(sensor.width_mm());
    let sensor = Sensor::new(width, args.pixels.unwrap_or(sensor.pixels() as u32), sensor.polar_deg())?;
    let walks = Walks::new(args.walks)?;
    Ok(JobSpec::new(scene.with_sensor(sensor), point, vec![medium.albedo()], walks, args.seed, false)?)
}

fn write_csv(scene: &Scene, profiles: &[Profile]) -> Result<()> {
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    writeln!(out, "channel,x_mm,value,std_error")?;
    for (channel, profile) in scene.channels().iter().zip(profiles) {
        let (values, errors) = (profile.radiance_factor.values(), profile.radiance_factor.std_errors());
        for (i, (value, error)) in values.iter().zip(errors).enumerate() {
            writeln!(out, "{},{},{value},{error}", channel.name(), scene.sensor().centre_mm(i))?;
        }
    }
    out.flush()?;
    Ok(())
}

#[derive(Debug, Serialize)]
struct SimulateJson {
    x_mm: Vec<f64>,
    walks: u64,
    seed: u64,
    channels: Vec<ChannelJson>,
}

#[derive(Debug, Serialize)]
struct ChannelJson {
    channel: String,
    values: Vec<f32>,
    std_errors: Vec<f32>,
}

impl ChannelJson {
    fn new(channel: &Channel, profile: &Profile) -> Self {
        Self {
            channel: channel.name().to_owned(),
            values: profile.radiance_factor.values().to_vec(),
            std_errors: profile.radiance_factor.std_errors().to_vec(),
        }
    }
}
