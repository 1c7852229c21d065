//! Names the people, instruments and certificates of a session, as a laboratory records them besides its photographs.

use optics_model::Invalid;
use serde::{Deserialize, Serialize};

/// The table `[record]` of a session file, which `session.json` keeps. All entries are free text.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SessionRecord {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub laboratory: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub operator: Option<String>,
    /// When the photographs were taken.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub date: Option<String>,
    /// Such as temperature and humidity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub conditions: Option<String>,
    /// Camera, lens and lamps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instrument: Option<String>,
    /// Licence of the data, such as an address.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub license: Option<String>,
    /// Certificate of the reflectance of the neutral patches.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub white_certificate: Option<String>,
    /// Certificate of the instrument that measured the slabs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thickness_certificate: Option<String>,
    /// Certificate of the size of the board's squares.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_certificate: Option<String>,
}

impl SessionRecord {
    /// Most characters of an entry.
    const LONGEST: usize = 300;

    /// Key, label and text of the entries that there are.
    pub fn entries(&self) -> Vec<(&'static str, &'static str, &str)> {
        let all = [
            ("laboratory", "Laboratory", &self.laboratory),
            ("operator", "Operator", &self.operator),
            ("date", "Date of the photographs", &self.date),
            ("conditions", "Conditions", &self.conditions),
            ("instrument", "Instrument", &self.instrument),
            ("license", "Licence of the data", &self.license),
            ("white_certificate", "Certificate of the white reference", &self.white_certificate),
            ("thickness_certificate", "Certificate of the thickness", &self.thickness_certificate),
            ("scale_certificate", "Certificate of the board's squares", &self.scale_certificate),
        ];
        all.into_iter().filter_map(|(key, label, text)| Some((key, label, text.as_deref()?))).collect()
    }

    /// Refuses entries that are empty, long or not printable.
    pub fn checked(self) -> Result<Self, Invalid> {
        for (key, _, text) in self.entries() {
            let is_long = text.chars().count() > Self::LONGEST;
            if text.trim().is_empty() || text.contains(char::is_control) || is_long {
                let allowed = format!("1 to {} printable characters are allowed", Self::LONGEST);
                return Err(Invalid::new(format!("record.{key}"), format!("{text:?}"), allowed));
            }
        }
        Ok(self)
    }
}
