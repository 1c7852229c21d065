//! Simulates sessions of a monochrome camera behind band-pass filters, with media whose spectra are known.

use std::fmt::Write as _;
use std::path::Path;

use optics_model::scene::Channel;
use optics_model::{Medium, Scene};
use optics_tracer::BareBoard;

use super::camera::Camera;
use super::session::{GREYS, Look, Session, What};
use super::subject::{Board, Edge, Slab};
use super::traced::traced_channel;
use crate::dng::dng;
use crate::reference::root;
use farm_lab::grid_file::read_scene;

/// A resin: σ_s falls with wavelength, σ_a has a constant part and a Gaussian line.
#[derive(Debug, Clone)]
pub struct SpectralMaterial {
    pub name: &'static str,
    /// σ_s at 550 nm in 1/mm, and the exponent of its fall.
    pub scattering: (f64, f64),
    /// σ_a away from the line, and its height, in 1/mm; place and standard deviation of the line in nm.
    pub absorption: (f64, f64),
    pub line_nm: (f64, f64),
}

impl SpectralMaterial {
    /// White has hardly any absorption, magenta a line in the green, and so on.
    pub const ALL: [Self; 5] = [
        Self { name: "white", scattering: (6.0, 0.7), absorption: (0.006, 0.02), line_nm: (420.0, 30.0) },
        Self { name: "magenta", scattering: (4.5, 0.5), absorption: (0.03, 1.2), line_nm: (550.0, 40.0) },
        Self { name: "cyan", scattering: (5.0, 0.6), absorption: (0.05, 1.5), line_nm: (660.0, 45.0) },
        Self { name: "yellow", scattering: (4.0, 0.8), absorption: (0.02, 2.0), line_nm: (430.0, 35.0) },
        Self { name: "grey", scattering: (3.0, 0.5), absorption: (0.5, 0.0), line_nm: (550.0, 50.0) },
    ];

    /// The medium at a wavelength; g falls by 0.05 per 100 nm.
    ///
    /// # Panics
    /// If there is no such medium.
    #[must_use]
    pub fn at(&self, wavelength_nm: f64) -> Medium {
        let sigma_s = self.scattering.0 * libm::pow(550.0 / wavelength_nm, self.scattering.1);
        let off = (wavelength_nm - self.line_nm.0) / self.line_nm.1;
        let sigma_a = self.absorption.0 + self.absorption.1 * libm::exp(-0.5 * off * off);
        let g = 0.4 - 0.05 * (wavelength_nm - 550.0) / 100.0;
        Medium::new(sigma_s + sigma_a, sigma_s / (sigma_s + sigma_a), g).expect("a medium of the example")
    }
}

/// The scene's file in examples/bands.
const SCENE: &str = "scene.toml";

/// Bands of the example.
pub const EXAMPLE_NM: [f64; 8] = [430.0, 470.0, 510.0, 550.0, 590.0, 630.0, 670.0, 710.0];

/// The bands of the paper's spectra: 31 from 400 to 700 nm.
#[must_use]
pub fn spectral_nm() -> Vec<f64> {
    (0..31).map(|i| 400.0 + 10.0 * f64::from(i)).collect()
}

/// A session with a band-pass filter for each wavelength.
#[derive(Debug, Clone)]
pub struct BandSession {
    pub wavelengths_nm: Vec<f64>,
    pub materials: Vec<SpectralMaterial>,
    /// Thicknesses of each material's slabs.
    pub slabs_mm: Vec<f64>,
    /// Shots of each slab.
    pub shots: u64,
    pub camera: Camera,
    /// The camera's channel behind the filters; None of a monochrome one.
    pub channel: Option<&'static str>,
    /// The set-up; its indices depend on the wavelength.
    pub scene: Scene,
    /// A share of the light of each band that has another wavelength in nm, which the filter does not block.
    pub leak: Option<(f64, f64)>,
    /// Walks of a slab's profile.
    pub walks: u64,
    pub seed: u64,
}

impl BandSession {
    /// A small camera: 28 × 22 mm at 26 pixels per millimetre, 12 bits.
    #[must_use]
    pub fn small(wavelengths_nm: &[f64], seed: u64) -> Self {
        let camera = Camera {
            width: 720,
            height: 576,
            px_per_mm: 26.0,
            turn_deg: 2.1,
            full: [2600.0; 3],
            numbers_per_electron: 0.1,
            read: 1.5,
            black: 64.0,
            clip: 4095.0,
            monochrome: true,
            ..Camera::default()
        };
        Self {
            wavelengths_nm: wavelengths_nm.to_vec(),
            materials: SpectralMaterial::ALL[..2].to_vec(),
            slabs_mm: vec![0.5, 1.0],
            shots: 2,
            camera,
            channel: None,
            scene: read_scene(&root().join("examples/bands").join(SCENE).to_string_lossy())
                .expect("the example has a scene"),
            leak: None,
            walks: 2_000_000,
            seed,
        }
    }

    /// ρ of the board's light and dark side.
    #[must_use]
    pub fn rho(wavelength_nm: f64) -> [f64; 2] {
        [0.95 + 0.03 * (wavelength_nm - 400.0) / 300.0, 0.03 - 0.01 * (wavelength_nm - 400.0) / 300.0]
    }

    /// The lens in a band: blur σ in mm, and magnification over that at 550 nm. It is sharpest in the green.
    #[must_use]
    pub fn lens(wavelength_nm: f64) -> (f64, f64) {
        let off = (wavelength_nm - 550.0) / 100.0;
        (0.026 + 0.004 * off * off, 1.0 + 2e-4 * off)
    }

    /// Writes photographs, session file and the table of the grey patches.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn write(&self, folder: &Path) -> std::io::Result<()> {
        std::fs::create_dir_all(folder)?;
        for (band, nm) in self.wavelengths_nm.iter().enumerate() {
            self.shoot_band(folder, band, *nm)?;
        }
        std::fs::write(folder.join("patches.csv"), patches())?;
        std::fs::copy(root().join("examples/bands").join(SCENE), folder.join(SCENE))?;
        std::fs::write(folder.join("session.toml"), self.file())
    }

    fn shoot_band(&self, folder: &Path, band: usize, nm: f64) -> std::io::Result<()> {
        let lit = self.lit(nm);
        let seen = |side: usize| lit.iter().map(|part| part.share * part.seen[side]).sum();
        let board = Board {
            square_mm: 20.0,
            light: [seen(0); 3],
            dark: [seen(1); 3],
            sign: 1.0,
            bow_per_mm: 0.0,
            spread_mm: 0.0,
        };
        let (lens_mm, magnification) = Self::lens(nm);
        let camera = Camera {
            lens_mm: [lens_mm; 3],
            px_per_mm: self.camera.px_per_mm * magnification,
            exposure_s: 0.05 + 0.05 * (band % 3) as f64,
            ..self.camera.clone()
        };
        let edge = |material: &SpectralMaterial, slab_mm: f64, seed: u64| {
            let traced = |part: &Lit| {
                let medium = material.at(part.nm);
                (part.share, traced_channel(&part.scene, &medium, slab_mm, self.walks, seed))
            };
            let edges: Vec<(f64, Edge)> = lit.iter().map(traced).collect();
            let edge =
                Edge::new(move |c, x_mm| edges.iter().map(|(share, edge)| share * edge.at(c, x_mm)).sum());
            Slab { board: board.clone(), edge, rim_mm: [-13.0, 13.0, -9.0, 9.0], bubble: None }
        };
        let look = Look { seed: self.seed * 100 + band as u64, flicker: 0.0005, exact: false, dust: None };
        let seconds = std::cell::Cell::new(900.0 * band as f64);
        let shoot = |session: &Session, what: What, name: &str, index: u64, count: u64| {
            (0..count).try_for_each(|i| {
                let mut photo = session.shoot(what, index + i, &look);
                seconds.set(seconds.get() + 30.0);
                photo.seconds = Some(seconds.get());
                std::fs::write(folder.join(format!("{nm}_{name}_{}.dng", i + 1)), dng(&photo))
            })
        };
        let mut session = Session::new(camera.clone(), edge(&self.materials[0], self.slabs_mm[0], 11));
        shoot(&session, What::Dark, "dark", 0, 2)?;
        shoot(&session, What::Sheet, "flat", 0, 2)?;
        shoot(&session, What::Chart, "chart", 0, 1)?;
        shoot(&session, What::Bare, "board", 0, 2)?;
        for (m, material) in self.materials.iter().enumerate() {
            for (s, slab_mm) in self.slabs_mm.iter().enumerate() {
                let number = (m * self.slabs_mm.len() + s) as u64;
                session.lay(&camera, &edge(material, *slab_mm, 11 + number));
                let name = format!("{}_{slab_mm}", material.name);
                shoot(&session, What::Slab, &name, 10 * number, self.shots)?;
            }
        }
        shoot(&session, What::Chart, "chart_after", 1, 1)
    }

    /// The wavelengths of a band's light.
    fn lit(&self, nm: f64) -> Vec<Lit> {
        let own = [(1.0 - self.leak.map_or(0.0, |(share, _)| share), nm)];
        let lit = |(share, nm): (f64, f64)| {
            let [light, dark] = Self::rho(nm);
            let channel = Channel::new(nm.to_string(), light, dark).expect("a board of the example");
            let scene = self.scene.of_channel(&channel).expect("indices of the example");
            let bare = BareBoard::of(&scene).expect("the scene has a board");
            Lit { nm, share, seen: [bare.apparent(light), bare.apparent(dark)], scene }
        };
        own.into_iter().chain(self.leak).map(lit).collect()
    }

    fn file(&self) -> String {
        let mut text =
            "scene = \"scene.toml\"\n\n[camera]\ndark = [\"{band}_dark_*.dng\"]\nflat = [\"{band}_flat_*.dng\"]\n\n[neutral]\n\
            shots = [\"{band}_chart_*.dng\"]\nrho = \"patches.csv\"\nstd_error = 0.005\ngeometry = \"own\"\n\n[target]\n\
            bare = [\"{band}_board_*.dng\"]\ndark_side = \"left\"\n"
                .to_owned();
        for nm in &self.wavelengths_nm {
            let channel = self.channel.map_or_else(String::new, |channel| format!("channel = {channel:?}\n"));
            _ = write!(text, "\n[[band]]\nwavelength_nm = {nm}\nfwhm_nm = 10\n{channel}");
        }
        for material in &self.materials {
            for slab_mm in &self.slabs_mm {
                let name = material.name;
                _ = write!(
                    text,
                    "\n[[sample]]\nmaterial = \"{name}\"\nthickness_mm = {slab_mm}\nthickness_std_error_mm = 0.002\n\
                     shots = [\"{{band}}_{name}_{slab_mm}_*.dng\"]\n"
                );
            }
        }
        text
    }
}

/// Light of one wavelength in a band.
struct Lit {
    nm: f64,
    /// Share of the light that the camera sees of white.
    share: f64,
    /// Radiance factors of the board's light and dark side.
    seen: [f64; 2],
    scene: Scene,
}

/// Reflectances of the grey patches over wavelength: neutral ones.
fn patches() -> String {
    let head: String = (1..=GREYS.len()).map(|i| format!(",patch_{i}")).collect();
    let greys: String = GREYS.iter().map(|rho| format!(",{rho}")).collect();
    format!("wavelength_nm{head}\n350{greys}\n800{greys}\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use optics_model::scene::Prior;

    /// The scene of examples/bands is `lab`, but for its dispersion.
    #[test]
    fn band_example_has_the_scene_lab() {
        let (scene, lab) = (BandSession::small(&EXAMPLE_NM, 1).scene, Scene::lab());
        assert!(scene.is_dispersive());
        let exact = |prior: &Prior| {
            Prior::new(prior.kind(), prior.layers().to_vec(), prior.std_error(), prior.scope()).unwrap()
        };
        let priors = scene.priors().iter().map(exact).collect();
        assert_eq!(scene.with_priors(priors).unwrap(), lab);
    }

    /// The files of examples/bands are those that the maker writes, but for comments.
    #[test]
    fn band_example_is_what_the_maker_writes() {
        let read = |name: &str| std::fs::read_to_string(root().join("examples/bands").join(name)).unwrap();
        let bare = |text: &str| -> String {
            let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default().trim_end());
            lines.collect::<Vec<_>>().join("\n").trim().to_owned()
        };
        assert_eq!(bare(&read("session.toml")), bare(&BandSession::small(&EXAMPLE_NM, 1).file()));
        assert_eq!(read("patches.csv"), patches());
    }
}
