//! Notes that an absorption changes much within the band of a filter or of a camera's colour, where one medium cannot
//! describe the profiles, that a filter probably passes light of other wavelengths, and that a session cannot show
//! either.
//!
//! The profile of a band is the mean over its wavelengths. A fit takes it for that of one medium, whose σ_a is off by
//! about s² (½ (ln σ_a)″ − 0.3 (ln σ_a)′²), where s is the standard deviation of the filter: simulated for magenta at the
//! top and on the slope of its line, to a fifth for filters of up to 40 nm. The derivatives are those of the parabola
//! through three neighbouring bands.

use farm_figures::numbers::significant;
use farm_lab::measurement_file::Note;
use farm_lab::session_folder::{BandWidth, Excited, SessionBands};
use optics_model::fit::{ChannelFit, MaterialFit};
use optics_model::measurement::{colour, wavelength_nm};

/// Smallest bias that is noted.
const LEAST: f64 = 0.01;
/// Smallest share of the half-width of σ_a's interval that is noted.
const LEAST_OF_INTERVAL: f64 = 0.5;
/// Half-width of σ_a's interval, as a share, up to which its change with wavelength is known.
const KNOWN: f64 = 0.5;
/// Most bands that a note names.
const MOST_NAMED: usize = 4;

/// Wavelength and standard deviation in nm of the colours of cameras, to some 10 nm those of 28 published sensitivities
/// (Jiang, Liu, Gu and Süsstrunk, What is the space of spectral sensitivity functions for digital color cameras?, 2013).
const COLOURS: [(&str, f64, f64); 3] = [("R", 600.0, 30.0), ("G", 535.0, 35.0), ("B", 465.0, 30.0)];
/// σ_a over σ_s(1 − g) from which on a medium absorbs so much that the width of its band matters.
const ABSORBING: f64 = 0.03;
/// Standard errors from which on a share of excited light is one.
const FIRM: f64 = 3.0;
/// Share of excited light below which it does not matter.
const LITTLE: f64 = 0.02;
/// Longest wavelength in nm that excites fluorescence in resins.
const BLUE_NM: f64 = 470.0;

/// Notes on what the bands of the channels make uncertain.
pub(super) fn notes(fits: &[MaterialFit], bands: &SessionBands) -> Vec<Note> {
    let notes = [wide(fits, bands), leaks(fits), unknown_band(fits, bands)];
    notes.into_iter().chain(fluorescence(fits, bands)).flatten().collect()
}

/// The band of a channel that is a camera's colour: by the camera's sensitivities, or the usual one.
fn colour_band(channel: &str, bands: &SessionBands) -> Option<BandWidth> {
    let name = colour(channel)?;
    let usual = || {
        let (_, wavelength_nm, std_dev_nm) = COLOURS.into_iter().find(|(usual, ..)| *usual == name)?;
        Some(BandWidth { wavelength_nm, std_dev_nm })
    };
    bands.colours.get(name).copied().or_else(usual)
}

/// The wavelength of a channel, at least about.
fn place_nm(channel: &str, bands: &SessionBands) -> Option<f64> {
    wavelength_nm(channel).or_else(|| colour_band(channel, bands).map(|band| band.wavelength_nm))
}

/// A channel whose σ_a is known well enough to show how it changes with wavelength.
#[derive(Debug, Clone, Copy)]
struct KnownBand<'a> {
    channel: &'a ChannelFit,
    nm: f64,
    ln_sigma_a: f64,
    /// Half-width of σ_a's interval, as a share.
    half_width: f64,
}

/// The known bands of a material, by wavelength.
fn known_bands<'a>(fit: &'a MaterialFit, bands: &SessionBands) -> Vec<KnownBand<'a>> {
    let known = fit.channels.iter().filter_map(|channel| {
        let (nm, refined) = (place_nm(&channel.channel, bands)?, channel.refined.as_ref()?);
        let sigma_a = refined.best.medium.absorption_per_mm();
        let interval = refined.absorption_per_mm;
        let half_width = 0.5 * (interval.high - interval.low) / sigma_a;
        let is_known = sigma_a > 0.0 && half_width < KNOWN && !interval.open_low && !interval.open_high;
        is_known.then(|| KnownBand { channel, nm, ln_sigma_a: libm::log(sigma_a), half_width })
    });
    let mut known: Vec<KnownBand> = known.collect();
    known.sort_by(|a, b| a.nm.total_cmp(&b.nm));
    known
}

fn is_absorbing(channel: &ChannelFit) -> bool {
    let medium = channel.refined.as_ref().map(|r| r.best.medium);
    medium.is_some_and(|m| m.absorption_per_mm() > ABSORBING * m.reduced_scattering_per_mm())
}

/// Materials and channels with a property, for a note; none if there are none.
fn named(fits: &[MaterialFit], has: impl Fn(&MaterialFit, &ChannelFit) -> bool) -> Option<String> {
    let channels = fits.iter().flat_map(|fit| fit.channels.iter().map(move |channel| (fit, channel)));
    let named = channels.filter(|(fit, channel)| has(fit, channel));
    first_few(
        &named.map(|(fit, channel)| format!("{} {}", fit.material, channel.channel)).collect::<Vec<_>>(),
    )
}

/// The first of a list for a note; none if it is empty.
fn first_few(all: &[String]) -> Option<String> {
    let more = all.len().saturating_sub(MOST_NAMED);
    let text = all[..all.len() - more].join(", ");
    let and_more = if more > 0 { format!(" and {more} more") } else { String::new() };
    (!all.is_empty()).then_some(text + &and_more)
}

/// Notes media that absorb in a channel whose band is not known, where too few others show how absorption changes.
fn unknown_band(fits: &[MaterialFit], bands: &SessionBands) -> Option<Note> {
    let is_alone = |fit: &MaterialFit, channel: &ChannelFit| {
        let is_unknown = wavelength_nm(&channel.channel).is_none();
        is_unknown && is_absorbing(channel) && known_bands(fit, bands).len() < COLOURS.len()
    };
    named(fits, is_alone).map(|named| Note {
        code: "UNKNOWN_BAND",
        text: format!(
            "the band of the channel is not known, and other channels do not show how absorption changes: {named}; σ_a is \
             some 20 % too small where it changes by a factor of 3 within the band, or where a resin fluoresces; name a \
             channel of narrow light by its wavelength, as in 550"
        ),
    })
}

/// Notes materials that fluoresce, and those that absorb blue more than other colours without shots that show how much of
/// that light comes back.
fn fluorescence(fits: &[MaterialFit], bands: &SessionBands) -> [Option<Note>; 2] {
    let shares = |fit: &MaterialFit| -> Vec<(&str, Excited)> {
        let slabs = bands.samples.iter().filter(|slab| slab.material == fit.material);
        let shares = slabs.filter_map(|slab| slab.fluorescence.as_ref()).flatten();
        shares.map(|(colour, share)| (colour.as_str(), *share)).collect()
    };
    let firm = |share: &Excited| share.value > FIRM * share.std_error;
    let excited = fits.iter().flat_map(|fit| {
        let shares = shares(fit).into_iter().filter(|(_, share)| firm(share));
        let percent = |share: Excited| significant(100.0 * share.value, 1);
        shares
            .map(|(colour, share)| format!("{} {colour} ({} %)", fit.material, percent(share)))
            .collect::<Vec<_>>()
    });
    let shown = first_few(&excited.collect::<Vec<_>>()).map(|named| Note {
        code: "FLUORESCENCE",
        text: format!(
            "blue light excites a part of the light of other channels: {named}; their σ_a is too small: photograph the whole \
             session under the filter that blocks blue, with a [[band]] for red and one for green"
        ),
    });
    let sigma_a = |c: &ChannelFit| c.refined.as_ref().map(|r| r.best.medium.absorption_per_mm());
    let absorbs_blue = |fit: &MaterialFit, channel: &ChannelFit| {
        let least = fit.channels.iter().filter_map(sigma_a).fold(f64::INFINITY, f64::min);
        let is_blue = place_nm(&channel.channel, bands).is_some_and(|nm| nm <= BLUE_NM);
        let shares = shares(fit);
        let is_known =
            |(_, share): &(&str, Excited)| firm(share) || share.value + 2.0 * share.std_error < LITTLE;
        let is_open = shares.is_empty() || !shares.iter().all(is_known);
        let absorbs =
            is_blue && is_absorbing(channel) && sigma_a(channel).is_some_and(|own| own > DARK * least);
        is_open && absorbs
    };
    let unknown = named(fits, absorbs_blue).map(|named| Note {
        code: "FLUORESCENCE_UNKNOWN",
        text: format!(
            "absorbs blue: {named}; if the resin fluoresces, σ_a of its other channels is too small, by some 20 % where 5 % \
             of that light comes back; a shot of it through a filter before the lamps that blocks blue shows it (`blue_cut`)"
        ),
    });
    [shown, unknown]
}

/// A band whose σ_a may be off.
#[derive(Debug)]
struct WideBand {
    name: String,
    /// Relative.
    bias: f64,
}

/// σ_a of a band over the least of its material from which on 1 % of light of other wavelengths shows.
const DARK: f64 = 3.0;
/// Probability below which data are not explained.
const UNEXPLAINED: f64 = 1e-3;

/// Notes materials that are unexplained in bands in which they absorb, and only there: with 1 % of light of another
/// wavelength in all bands p was 1e-55 at the top of magenta's line, 1e-9 on its slopes, and above 0.1 elsewhere.
fn leaks(fits: &[MaterialFit]) -> Option<Note> {
    let named = fits.iter().flat_map(unexplained_where_dark).collect::<Vec<_>>().join(", ");
    (!named.is_empty()).then(|| Note {
        code: "LEAKING_FILTER",
        text: format!(
            "unexplained where the material absorbs, and only there: {named}; a filter that passes 1 % of light of other \
             wavelengths does this, and makes σ_a too small: block them by a second filter"
        ),
    })
}

fn unexplained_where_dark(fit: &MaterialFit) -> Vec<String> {
    let band = |channel: &ChannelFit| {
        let (nm, refined) = (wavelength_nm(&channel.channel)?, channel.refined.as_ref()?);
        let is_explained = refined.likelihood.probability >= UNEXPLAINED;
        Some((nm, refined.best.medium.absorption_per_mm(), is_explained))
    };
    let bands: Vec<(f64, f64, bool)> = fit.channels.iter().filter_map(band).collect();
    let least = bands.iter().map(|(_, sigma_a, _)| *sigma_a).fold(f64::INFINITY, f64::min);
    let unexplained = || bands.iter().filter(|(.., is_explained)| !is_explained);
    if unexplained().all(|(_, sigma_a, _)| *sigma_a >= DARK * least) {
        unexplained().map(|(nm, ..)| format!("{} {nm} nm", fit.material)).collect()
    } else {
        Vec::new()
    }
}

/// None if the bands are narrow enough.
fn wide(fits: &[MaterialFit], bands: &SessionBands) -> Option<Note> {
    let mut wide: Vec<WideBand> = fits.iter().flat_map(|fit| wide_bands(fit, bands)).collect();
    wide.sort_by(|a, b| b.bias.total_cmp(&a.bias));
    let named = wide.iter().map(|band| format!("{} (by {} %)", band.name, significant(100.0 * band.bias, 1)));
    first_few(&named.collect::<Vec<_>>()).map(|named| Note {
        code: "WIDE_BANDS",
        text: format!(
            "the absorption changes so much within the band that σ_a may be off: {named}; take narrower filters there, or a \
             narrow light"
        ),
    })
}

fn wide_bands(fit: &MaterialFit, bands: &SessionBands) -> Vec<WideBand> {
    let known = known_bands(fit, bands);
    if known.len() < 3 {
        return Vec::new();
    }
    let wide = |i: usize| {
        let first = i.saturating_sub(1).min(known.len() - 3);
        let KnownBand { channel, nm, half_width, .. } = known[i];
        let is_colour = colour(&channel.channel).is_some();
        // Bands of cameras are known by their usual widths only: clear media are not doubted by them.
        if is_colour && bands.colours.is_empty() && !is_absorbing(channel) {
            return None;
        }
        let filter_band = || bands.bands.iter().find(|band| band.wavelength_nm == nm).copied();
        let std_dev_nm = colour_band(&channel.channel, bands).or_else(filter_band)?.std_dev_nm;
        let (slope, curvature) = derivatives(&known[first..first + 3], nm);
        let bias = std_dev_nm.powi(2) * (0.5 * curvature - 0.3 * slope * slope).abs();
        let is_large = bias > LEAST && bias > LEAST_OF_INTERVAL * half_width;
        let unit = if is_colour { "" } else { " nm" };
        is_large.then(|| WideBand { name: format!("{} {}{unit}", fit.material, channel.channel), bias })
    };
    (0..known.len()).filter_map(wide).collect()
}

/// First and second derivative at `nm` of the parabola through three points.
fn derivatives(bands: &[KnownBand], nm: f64) -> (f64, f64) {
    let [(x0, y0), (x1, y1), (x2, y2)] = [0, 1, 2].map(|i| (bands[i].nm, bands[i].ln_sigma_a));
    let (first, second) = ((y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1));
    let half = (second - first) / (x2 - x0);
    (first + half * (2.0 * nm - x0 - x1), 2.0 * half)
}

#[cfg(test)]
mod tests {
    use farm_figures::testing;
    use optics_model::Medium;

    use super::*;

    /// Bands of a Gaussian line of 40 nm at 550 nm, whose σ_a is known to 1 %.
    fn line(wavelengths: &[f64]) -> MaterialFit {
        let channel = |nm: &f64| {
            let sigma_a = 1.2 * libm::exp(-0.5 * ((nm - 550.0) / 40.0).powi(2));
            let mut channel = testing::channel(&nm.to_string(), 5.0 + sigma_a, 1.0);
            let refined = channel.refined.as_mut().unwrap();
            refined.best.medium = Medium::new(5.0 + sigma_a, 5.0 / (5.0 + sigma_a), 0.4).unwrap();
            (refined.absorption_per_mm.low, refined.absorption_per_mm.high) =
                (0.99 * sigma_a, 1.01 * sigma_a);
            channel
        };
        MaterialFit { material: "magenta".into(), channels: wavelengths.iter().map(channel).collect() }
    }

    /// Misfits in dark bands alone are noted; those of a single band, or in bright ones, have other causes.
    #[test]
    fn misfits_where_dark_are_leaks() {
        let text = |unexplained: &[&str]| {
            let mut fit = line(&[430.0, 470.0, 550.0]);
            for channel in &mut fit.channels {
                let is_unexplained = unexplained.contains(&channel.channel.as_str());
                channel.refined.as_mut().unwrap().likelihood.probability =
                    if is_unexplained { 1e-9 } else { 0.4 };
            }
            leaks(&[fit]).map(|note| note.text)
        };
        assert!(
            text(&["550"]).unwrap().contains("only there: magenta 550 nm; a filter"),
            "{:?}",
            text(&["550"])
        );
        assert_eq!([text(&[]), text(&["430", "550"]), text(&["430"])], [None, None, None]);
    }

    /// Inks with these absorptions per mm in channels with these names.
    fn ink(channels: &[(&str, f64)]) -> Vec<MaterialFit> {
        let channel = |(name, sigma_a): &(&str, f64)| {
            let mut channel = testing::channel(name, 5.0 + sigma_a, 1.0);
            let refined = channel.refined.as_mut().unwrap();
            refined.best.medium = Medium::new(5.0 + sigma_a, 5.0 / (5.0 + sigma_a), 0.4).unwrap();
            // Little absorption is known to 20 %.
            let error = if *sigma_a < 0.05 { 0.2 } else { 0.02 };
            refined.absorption_per_mm.low = (1.0 - error) * sigma_a;
            refined.absorption_per_mm.high = (1.0 + error) * sigma_a;
            channel
        };
        vec![MaterialFit { material: "ink".into(), channels: channels.iter().map(channel).collect() }]
    }

    /// A white has no note; yellow is uncertain in blue, where it may fluoresce, and a single channel shows nothing.
    #[test]
    fn coloured_media_of_cameras_are_noted() {
        let codes = |channels: &[(&str, f64)]| -> Vec<&str> {
            notes(&ink(channels), &SessionBands::default()).iter().map(|note| note.code).collect()
        };
        assert_eq!(codes(&[("R", 0.002), ("G", 0.003), ("B", 0.008)]), [""; 0]);
        assert_eq!(codes(&[("R", 0.002), ("G", 0.002), ("B", 0.023)]), [""; 0]);
        assert_eq!(codes(&[("R", 0.05), ("G", 0.2), ("B", 1.5)]), ["WIDE_BANDS", "FLUORESCENCE_UNKNOWN"]);
        assert_eq!(codes(&[("R", 1.5), ("G", 0.3), ("B", 0.1)]), ["WIDE_BANDS"]);
        // Where the others absorb too little to be known, nothing shows how absorption changes.
        let mut cyan = ink(&[("R", 1.5), ("G", 0.01), ("B", 0.01)]);
        cyan[0].channels[1].refined.as_mut().unwrap().absorption_per_mm.open_low = true;
        assert_eq!(
            notes(&cyan, &SessionBands::default()).iter().map(|note| note.code).collect::<Vec<_>>(),
            ["UNKNOWN_BAND"]
        );
        assert_eq!(codes(&[("mono", 1.5)]), ["UNKNOWN_BAND"]);
        assert_eq!(codes(&[("450", 1.5), ("550", 0.1)]), ["FLUORESCENCE_UNKNOWN"]);
        assert_eq!((codes(&[("mono", 0.01)]), codes(&[("450", 1.5)])), (vec![], vec![]));
        let text = notes(&ink(&[("red", 1.5), ("green", 0.3), ("blue", 0.1)]), &SessionBands::default())
            .remove(0)
            .text;
        assert!(text.contains("ink red (by 17 %)"), "{text}");
    }

    /// Shots without blue end the doubt, or show the share; sensitivities replace the usual bands of cameras.
    #[test]
    fn session_knows_fluorescence_and_bands() {
        let yellow = ink(&[("R", 0.05), ("G", 0.2), ("B", 1.5)]);
        let session = |share: f64, error: f64| -> SessionBands {
            let text = format!(
                r#"{{"samples": [{{"material": "ink", "fluorescence": {{"R": {{"value": {share}, "std_error": {error}}}}}}}],
                    "colours": {{"R": {{"wavelength_nm": 610, "std_dev_nm": 2}}, "G": {{"wavelength_nm": 540, "std_dev_nm": 2}},
                                 "B": {{"wavelength_nm": 460, "std_dev_nm": 2}}}}}}"#
            );
            SessionBands::known(&serde_json::from_str(&text).unwrap())
        };
        let codes = |share: f64, error: f64| {
            notes(&yellow, &session(share, error)).iter().map(|n| n.code).collect::<Vec<_>>()
        };
        assert_eq!(codes(0.004, 0.003), [""; 0]);
        assert_eq!(codes(0.018, 0.003), ["FLUORESCENCE"]);
        assert_eq!(codes(0.01, 0.02), ["FLUORESCENCE_UNKNOWN"], "too uncertain");
        assert!(notes(&yellow, &session(0.04, 0.003))[0].text.contains("ink R (4 %)"));
    }

    /// Biases of simulated filters of 40 nm were 9 % at the top and 17 % on the slope, of 10 nm 0.5 and 1.4 %.
    #[test]
    fn wide_bands_are_noted() {
        let wavelengths = [500.0, 550.0, 600.0];
        let widths = |fwhm: f64| {
            let band = |wavelength_nm| BandWidth { wavelength_nm, std_dev_nm: fwhm / 2.3548 };
            SessionBands { bands: wavelengths.map(band).to_vec(), ..SessionBands::default() }
        };
        let biases: Vec<f64> =
            wide_bands(&line(&wavelengths), &widths(40.0)).iter().map(|band| band.bias).collect();
        for (found, simulated) in biases.iter().zip([0.17, 0.09, 0.17]) {
            assert!((found / simulated - 1.0).abs() < 0.2, "{biases:?}");
        }
        let text = wide(&[line(&wavelengths)], &widths(40.0)).unwrap().text;
        assert!(text.contains("magenta 500 nm (by 17 %)"), "{text}");
        assert_eq!(wide_bands(&line(&wavelengths), &widths(10.0)).len(), 2, "the slopes");
        assert_eq!(wide(&[line(&wavelengths)], &widths(3.0)), None);
        assert_eq!(wide(&[line(&[500.0, 550.0])], &widths(40.0)), None, "two bands have no curvature");
    }
}
