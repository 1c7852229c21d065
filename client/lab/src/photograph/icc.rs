//! Checks whether a colour profile declares linear values (ICC.1:2010, Secs. 7.3 and 10.5).

/// The tone curve of a profile, if it is not straight.
pub(super) fn tone_curve(profile: &[u8]) -> Option<String> {
    let count = u32_at(profile, 128)?.min(100);
    (0..count as usize).find_map(|i| {
        let entry = profile.get(132 + 12 * i..144 + 12 * i)?;
        let is_curve = [&b"rTRC"[..], b"gTRC", b"bTRC", b"kTRC"].contains(&&entry[..4]);
        let from = u32_at(entry, 4)? as usize;
        let curve = is_curve.then(|| profile.get(from..))??;
        described(curve)
    })
}

/// Describes a curve; `None` if it is straight.
fn described(curve: &[u8]) -> Option<String> {
    match curve.get(..4)? {
        b"curv" => match u32_at(curve, 8)? {
            0 => None,
            1 => gamma(f64::from(u16::from_be_bytes([*curve.get(12)?, *curve.get(13)?])) / 256.0),
            n => {
                let straight = (0..n as usize).all(|i| {
                    let at = 12 + 2 * i;
                    let Some(&[high, low]) = curve.get(at..at + 2) else { return true };
                    let value = f64::from(u16::from_be_bytes([high, low])) / 65_535.0;
                    (value - i as f64 / f64::from(n - 1)).abs() < 1e-3
                });
                (!straight).then(|| "a curve in its colour profile".to_owned())
            }
        },
        // Only Y = X^g can be straight among the parametric curves.
        b"para" => match curve.get(8..10)? {
            [0, 0] => gamma(f64::from(u32_at(curve, 12)?) / 65_536.0),
            _ => Some("a curve in its colour profile".to_owned()),
        },
        _ => None,
    }
}

fn gamma(exponent: f64) -> Option<String> {
    ((exponent - 1.0).abs() > 1e-3).then(|| format!("gamma {exponent:.2} in its colour profile"))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    let b = bytes.get(at..at + 4)?;
    Some(u32::from_be_bytes([b[0], b[1], b[2], b[3]]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn profile(curve: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; 128];
        bytes.extend(1_u32.to_be_bytes());
        bytes.extend(b"rTRC");
        bytes.extend(144_u32.to_be_bytes());
        bytes.extend((curve.len() as u32).to_be_bytes());
        bytes.extend(curve);
        bytes
    }

    fn curv(values: &[u16]) -> Vec<u8> {
        let mut bytes = b"curv\0\0\0\0".to_vec();
        bytes.extend((values.len() as u32).to_be_bytes());
        bytes.extend(values.iter().flat_map(|v| v.to_be_bytes()));
        bytes
    }

    #[test]
    fn straight_curves_pass_and_others_are_named() {
        for straight in [&[][..], &[256], &[0, 32_768, 65_535]] {
            assert_eq!(tone_curve(&profile(&curv(straight))), None, "{straight:?}");
        }
        assert_eq!(tone_curve(&profile(&curv(&[563]))).unwrap(), "gamma 2.20 in its colour profile");
        assert!(tone_curve(&profile(&curv(&[0, 10_000, 65_535]))).is_some());
        let srgb = [&b"para\0\0\0\0\0\x03\0\0"[..], &[0; 20]].concat();
        assert!(tone_curve(&profile(&srgb)).is_some());
        assert_eq!(tone_curve(b"nonsense"), None);
    }
}
