//! Describes the folder of a measured session as a research object (RO-Crate 1.1), so that archives and search engines
//! read who measured what, with which program, and which file is what.

use std::path::Path;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use crate::media_file::MEDIA_FILE;
use crate::record::SessionRecord;
use crate::uncertainty::UNCERTAINTY_FILE;
use crate::whole_file::write_whole;

/// Name of the file, which the specification defines.
pub const RESEARCH_OBJECT_FILE: &str = "ro-crate-metadata.json";

/// Name of the file with the whole answer of a measurement.
pub const ANSWER_FILE: &str = "answer.json";

/// Files that a measurement adds to the folder of a session.
pub const MEASURED_FILES: [&str; 9] = [
    ANSWER_FILE,
    MEDIA_FILE,
    UNCERTAINTY_FILE,
    RESEARCH_OBJECT_FILE,
    "table.csv",
    "media.py",
    "media.xml",
    "media.pbrt",
    "media_blender.py",
];

/// Files of a session: name, contents and media type.
const FILES: [(&str, &str, &str); 9] = [
    ("measurements.csv", "Profiles across the edge", "text/csv"),
    ("session.json", "Set-up, and photographs with their digests", "application/json"),
    ("scene.toml", "Layers, lamps and sensor", "application/toml"),
    ("grid.toml", "Grid of the session's dictionary", "application/toml"),
    ("report.html", "Report of the session", "text/html"),
    ("report.json", "Data of the report", "application/json"),
    (MEDIA_FILE, "Optical parameters with their covariance", "application/json"),
    (ANSWER_FILE, "Media with intervals, error budgets and fits", "application/json"),
    (UNCERTAINTY_FILE, "Statement of uncertainty", "text/html"),
];

/// The contents of a research object.
#[derive(Debug, Clone, Copy)]
pub struct ResearchObject<'a> {
    pub materials: &'a [&'a str],
    pub record: &'a SessionRecord,
    /// The date as `2026-11-25`.
    pub date: &'a str,
}

impl ResearchObject<'_> {
    /// Writes the file for those files of a session that a folder has.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let files: Vec<_> = FILES.into_iter().filter(|(name, ..)| folder.join(name).exists()).collect();
        let text = serde_json::to_string_pretty(&self.json(&files))? + "\n";
        let path = folder.join(RESEARCH_OBJECT_FILE);
        write_whole(&path, text.as_bytes()).with_context(|| format!("writing {}", path.display()))
    }

    fn json(&self, files: &[(&str, &str, &str)]) -> Value {
        let reference = |id: &str| json!({"@id": id});
        let parts: Vec<Value> = files.iter().map(|(name, ..)| reference(name)).collect();
        let mut root = json!({
            "@id": "./",
            "@type": "Dataset",
            "name": format!("Optical parameters of {}", self.materials.join(", ")),
            "description": "Extinction, albedo and anisotropy of translucent materials, measured by photographs of \
                            thin slabs over a black–white edge.",
            "datePublished": self.date,
            "license": self.record.license.as_deref().unwrap_or("No licence is stated."),
            "hasPart": parts.clone(),
        });
        let mut action = json!({
            "@id": "#measurement",
            "@type": "CreateAction",
            "name": "Measurement of optical parameters",
            "instrument": [reference("#farmctl")],
            "result": parts,
        });
        if let Some(date) = &self.record.date {
            action["startTime"] = json!(date);
        }
        let program = json!({
            "@id": "#farmctl",
            "@type": "SoftwareApplication",
            "name": "farmctl",
            "version": env!("CARGO_PKG_VERSION"),
        });
        let mut graph = vec![
            json!({
                "@id": RESEARCH_OBJECT_FILE,
                "@type": "CreativeWork",
                "about": reference("./"),
                "conformsTo": reference("https://w3id.org/ro/crate/1.1"),
            }),
            program,
        ];
        if let Some(instrument) = &self.record.instrument {
            action["instrument"] = json!([reference("#farmctl"), reference("#instrument")]);
            graph.push(json!({"@id": "#instrument", "@type": "Product", "name": instrument}));
        }
        if let Some(laboratory) = &self.record.laboratory {
            root["publisher"] = reference("#laboratory");
            graph.push(json!({"@id": "#laboratory", "@type": "Organization", "name": laboratory}));
        }
        if let Some(operator) = &self.record.operator {
            root["author"] = reference("#operator");
            action["agent"] = reference("#operator");
            graph.push(json!({"@id": "#operator", "@type": "Person", "name": operator}));
        }
        let file = |(name, about, format): &(&str, &str, &str)| json!({"@id": name, "@type": "File", "name": name, "description": about, "encodingFormat": format});
        graph.extend([root, action]);
        graph.extend(files.iter().map(file));
        json!({"@context": "https://w3id.org/ro/crate/1.1/context", "@graph": graph})
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Only files that exist are parts; entities refer to those of the graph.
    #[test]
    fn research_objects_refer_to_their_entities() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("report.html"), "x").unwrap();
        let text = |text: &str| Some(text.to_owned());
        let record = SessionRecord {
            operator: text("A. B."),
            laboratory: text("L"),
            instrument: text("C"),
            ..SessionRecord::default()
        };
        let object = ResearchObject { materials: &["white"], record: &record, date: "2026-11-25" };
        object.write(folder.path()).unwrap();
        let text = std::fs::read_to_string(folder.path().join(RESEARCH_OBJECT_FILE)).unwrap();
        let json: Value = serde_json::from_str(&text).unwrap();
        let graph = json["@graph"].as_array().unwrap();
        let known: Vec<&str> = graph.iter().map(|entity| entity["@id"].as_str().unwrap()).collect();
        let root = graph.iter().find(|entity| entity["@id"] == "./").unwrap();
        assert_eq!(root["hasPart"], json!([{"@id": "report.html"}]));
        assert_eq!(root["name"], "Optical parameters of white");
        let action = graph.iter().find(|entity| entity["@type"] == "CreateAction").unwrap();
        for reference in [&root["author"], &root["publisher"], &action["agent"], &action["instrument"][1]] {
            assert!(known.contains(&reference["@id"].as_str().unwrap()), "{reference} {known:?}");
        }
    }
}
