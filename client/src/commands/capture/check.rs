//! Single photographs, while the slab still lies there.

use std::path::Path;
use std::process::ExitCode;

use anyhow::Result;
use optics_capture::{Photo, ShotCheck, check_shot};
use serde_json::{Value, json};

use crate::capture::{Shots, pattern};
use crate::cli::CaptureArgs;
use crate::output::{Output, warning};

/// A photograph that is usable.
struct Seen {
    exposure: Option<String>,
    check: ShotCheck,
}

pub(super) fn run(args: &CaptureArgs, output: &Output) -> Result<ExitCode> {
    let colours = args.pattern.as_deref().map(pattern).transpose().map_err(|e| e.renamed("pattern"))?;
    let look = |path: &Path| -> Result<Seen> {
        let photo: Photo = Shots::new(colours, Path::new("")).read(path)?;
        Ok(Seen { exposure: photo.exposure.map(|e| e.to_string()), check: check_shot(&photo)? })
    };
    let shots: Vec<(&Path, Result<Seen>)> =
        args.check.iter().map(|path| (path.as_path(), look(path))).collect();
    let usable = shots.iter().all(|(_, seen)| seen.is_ok());
    let data: Vec<Value> = shots.iter().map(|(path, seen)| data(path, seen)).collect();
    output.print("check", &json!({"usable": usable, "shots": data}), || {
        shots.iter().map(|(path, seen)| text(path, seen)).collect::<Vec<_>>().join("\n")
    })?;
    Ok(if usable { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn data(path: &Path, seen: &Result<Seen>) -> Value {
    match seen {
        Err(error) => json!({"photograph": path, "usable": false, "reason": reason(path, error)}),
        Ok(Seen { exposure, check }) => json!({
            "photograph": path,
            "usable": true,
            "exposure": exposure,
            "clipped_share": check.clipped_share,
            "brightness_share": check.brightness_share,
            "blur_px": check.edges.map(|edge| Some(edge?.blur_px?.value)),
            "angle_deg": check.edges.map(|edge| Some(edge?.angle_deg.value)),
            "warnings": check.warnings.iter().map(ToString::to_string).collect::<Vec<_>>(),
        }),
    }
}

/// What is wrong, without the photograph's name, which stands before it.
fn reason(path: &Path, error: &anyhow::Error) -> String {
    let reason = format!("{error:#}");
    let name = path.display().to_string();
    let reason = reason.strip_prefix("photograph ").unwrap_or(&reason);
    reason.strip_prefix(&format!("{name}: ")).unwrap_or(reason).to_owned()
}

fn text(path: &Path, seen: &Result<Seen>) -> String {
    let name = path.display();
    let Seen { exposure, check } = match seen {
        Err(error) => return format!("{name}: {}", warning(&format!("not usable: {}", reason(path, error)))),
        Ok(seen) => seen,
    };
    let percent = |shares: [f64; 3]| shares.map(|share| format!("{:.0}", 100.0 * share)).join("/");
    let mut words =
        vec![format!("{name}: usable, brightest {} % of full (R/G/B)", percent(check.brightness_share))];
    let edges = check.edges.iter().zip(["sideways", "up and down"]);
    words.extend(edges.filter_map(|(edge, way)| {
        let edge = edge.as_ref()?;
        let (blur, angle) = (edge.blur_px?.value, edge.angle_deg.value);
        Some(format!("longest edge {blur:.2} px {way}, turned by {angle:+.2}°"))
    }));
    words.extend(exposure.clone());
    let prefix = format!("{name}: ");
    let warnings = check.warnings.iter().map(ToString::to_string);
    let warnings = warnings.map(|w| format!("\n  {}", warning(w.strip_prefix(&prefix).unwrap_or(&w))));
    words.join(", ") + &warnings.collect::<String>()
}
