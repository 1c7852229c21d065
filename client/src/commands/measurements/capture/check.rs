//! Checks single photographs, before the slab is moved: given ones, or those that arrive in a folder.

mod arrivals;

use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::Result;
use farm_lab::capture::{Shots, pattern};
use farm_lab::photograph::Orientation;
use farm_link::logs::to_stderr;
use optics_capture::{Colour, Darks, Photo, ShotCheck, check_shot};
use serde_json::{Value, json};

use super::CaptureArgs;
use crate::interrupt::interrupted;
use crate::output::{Output, warning};
use arrivals::NewPhotographs;

/// A usable photograph.
struct UsableShot {
    exposure: Option<String>,
    orientation: Option<Orientation>,
    check: ShotCheck,
}

/// Checks photographs with the same mosaic and dark shots.
struct ShotChecker {
    colours: Option<[Colour; 4]>,
    darks: Darks,
}

impl ShotChecker {
    fn new(args: &CaptureArgs) -> Result<Self> {
        let colours = args.pattern.as_deref().map(pattern).transpose().map_err(|e| e.renamed("pattern"))?;
        let mut darks = Darks::new();
        let mut dark_shots = Shots::new(colours, Path::new(""));
        for path in &args.darks {
            darks.add(dark_shots.read(path, "dark")?)?;
        }
        Ok(Self { colours, darks })
    }

    fn check(&self, path: &Path) -> Result<UsableShot> {
        let mut shots = Shots::new(self.colours, Path::new(""));
        let photo: Photo = shots.read(path, "")?;
        let exposure = photo.exposure.map(|e| e.to_string());
        let orientation = shots.into_inputs().pop().and_then(|input| input.about.orientation);
        Ok(UsableShot { exposure, orientation, check: check_shot(&photo, self.darks.clone())? })
    }
}

pub(super) fn run(args: &CaptureArgs, output: &Output) -> Result<ExitCode> {
    let checker = ShotChecker::new(args)?;
    let shots: Vec<(&Path, Result<UsableShot>)> =
        args.check.iter().map(|path| (path.as_path(), checker.check(path))).collect();
    let usable = shots.iter().all(|(_, seen)| seen.is_ok());
    print(&shots, usable, output)?;
    Ok(if usable { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn print(shots: &[(&Path, Result<UsableShot>)], usable: bool, output: &Output) -> Result<()> {
    let data: Vec<Value> = shots.iter().map(|(path, seen)| data(path, seen)).collect();
    output.print("check", &json!({"usable": usable, "shots": data}), || {
        shots.iter().map(|(path, seen)| text(path, seen)).collect::<Vec<_>>().join("\n")
    })
}

/// Time between two looks at a watched folder.
const LOOK: Duration = Duration::from_millis(500);

/// Checks each photograph that appears in a folder once its file does not grow any more, until Ctrl-C.
pub(super) async fn watch(args: &CaptureArgs, folder: &Path, output: &Output) -> Result<ExitCode> {
    let checker = ShotChecker::new(args)?;
    let mut arrivals = NewPhotographs::new(folder)?;
    to_stderr(format_args!("farmctl: watching {} for new photographs; Ctrl-C ends", folder.display()));
    loop {
        tokio::select! {
            () = interrupted() => return Ok(ExitCode::SUCCESS),
            () = tokio::time::sleep(LOOK) => {}
        }
        for path in arrivals.complete()? {
            let seen = checker.check(&path);
            let usable = seen.is_ok();
            print(&[(&path, seen)], usable, output)?;
        }
    }
}

fn data(path: &Path, seen: &Result<UsableShot>) -> Value {
    let photograph = path.display().to_string();
    match seen {
        Err(error) => json!({"photograph": photograph, "usable": false, "reason": reason(path, error)}),
        Ok(UsableShot { exposure, orientation, check }) => json!({
            "photograph": photograph,
            "usable": true,
            "exposure": exposure,
            "orientation": orientation.map(Orientation::number),
            "clipped_share": check.clipped_share,
            "brightness_share": check.brightness_share,
            "blur_px": check.edges.map(|edge| Some(edge?.blur_px?.value)),
            "angle_deg": check.edges.map(|edge| Some(edge?.angle_deg.value)),
            "warnings": check.warnings.iter().map(ToString::to_string).collect::<Vec<_>>(),
        }),
    }
}

/// The reason of an error, without the photograph's name, which is printed before it.
fn reason(path: &Path, error: &anyhow::Error) -> String {
    let reason = format!("{error:#}");
    let name = path.display().to_string();
    let reason = reason.strip_prefix("photograph ").unwrap_or(&reason);
    reason.strip_prefix(&format!("{name}: ")).unwrap_or(reason).to_owned()
}

fn text(path: &Path, seen: &Result<UsableShot>) -> String {
    let name = path.display();
    let UsableShot { exposure, orientation, check } = match seen {
        Err(error) => return format!("{name}: {}", warning(&format!("not usable: {}", reason(path, error)))),
        Ok(seen) => seen,
    };
    let percent = |share: &f64| format!("{:.0}", 100.0 * share);
    let brightest = check.brightness_share.iter().map(percent).collect::<Vec<_>>().join("/");
    let mut words = vec![format!("{name}: usable, brightest {brightest} % of full (R/G/B)")];
    let edges = check.edges.iter().zip(["sideways", "up and down"]);
    words.extend(edges.filter_map(|(edge, way)| {
        let edge = edge.as_ref()?;
        let (blur, angle) = (edge.blur_px?.value, edge.angle_deg.value);
        Some(format!("longest edge {blur:.2} px {way}, turned by {angle:+.2}°"))
    }));
    words.extend(exposure.clone());
    let turned = orientation.filter(|orientation| !orientation.is_as_stored());
    words.extend(turned.map(|orientation| format!("Orientation {orientation}, used as stored")));
    let prefix = format!("{name}: ");
    let warnings = check.warnings.iter().map(ToString::to_string);
    let warnings = warnings.map(|w| format!("\n  {}", warning(w.strip_prefix(&prefix).unwrap_or(&w))));
    words.join(", ") + &warnings.collect::<String>()
}
