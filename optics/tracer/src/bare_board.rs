//! Computes the radiance factor of the bare board in air: a Lambertian base under its coat.
//!
//! Light that enters the coat meets the base, returns to it with the probability b or leaves, again and again, so the
//! radiance factor of a base with the reflectance ρ is exactly
//!
//! s + a ρ / (1 − b ρ)
//!
//! * s: light that the coat's face reflects from the ring into the camera,
//! * a = T(camera → base) T(base → ring), the second by reciprocity (n² cos θ dω is the same from both sides):
//!   1/n² times the mean transmittance of the ring's directions,
//! * b: the share of a Lambertian source under the coat that its face sends back. Where the face loses no light, it is 1
//!   less what passes, which is by reciprocity 1/n² times that of a source in air. Fewer rays meet the face again on that
//!   side, so the sum has less noise.
//!
//! All are integrals over the coat's [`Face`], accurate to 1e-4.

use std::cell::OnceCell;

use glam::Vec3;
use optics_model::angle::sin2;
use optics_model::scene::{Channel, LEAST_RHO_DARK, LayerMedium};
use optics_model::{Invalid, Scene};
use rayon::prelude::*;

use super::face::{Face, FacePoint, FaceRays, FaceSide};

/// Points of each sum, and of that over the directions in which light from the camera is reflected: few meet the ring.
const POINTS: u32 = 1 << 17;
const VIEW_POINTS: u32 = 1 << 18;

/// The three numbers of the bare board's radiance factor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BareBoard {
    /// s.
    pub specular: f64,
    /// a.
    pub gain: f64,
    /// b.
    pub returned: f64,
}

impl BareBoard {
    /// The board of a scene. Its coat is the layer of zero thickness on the base; all other layers above or below the
    /// sample are present in photographs of samples only.
    pub fn of(scene: &Scene) -> Result<Self, Invalid> {
        let Some(coat) = coat(scene)? else {
            return Ok(Self { specular: 0.0, gain: 1.0, returned: 0.0 });
        };
        let (ring, view) = (scene.light(), sin2(scene.sensor().polar_deg()));
        let [inner, outer] = [ring.inner_deg(), ring.outer_deg()].map(sin2);
        let in_ring = |d: Vec3| (inner..=outer).contains(&f64::from(d.x * d.x + d.y * d.y));
        let back = |d: Vec3| d.z > 0.0;
        let above = |sin2: f64, point: FacePoint| coat.rays(FaceSide::Above, sin2, point);
        let [entering, specular] = means(VIEW_POINTS, |point| {
            let rays = above(view, point);
            [share(&rays, |d| !back(d)), share(&rays, |d| back(d) && in_ring(d))]
        });
        let [lit] =
            means(POINTS, |point| [share(&above(inner + point.u * (outer - inner), point), |d| !back(d))]);
        let per_n2 = coat.iors[1].powi(-2);
        let returned = if coat.multiple_scattering {
            let [passes] = means(POINTS, |point| [share(&above(point.u, point), |d| !back(d))]);
            1.0 - per_n2 * passes
        } else {
            let [returned] =
                means(POINTS, |point| [share(&coat.rays(FaceSide::Below, point.u, point), back)]);
            returned
        };
        Ok(Self { specular: specular / (outer - inner), gain: entering * lit * per_n2, returned })
    }

    /// Radiance factor of a base with the reflectance `rho`.
    pub fn apparent(&self, rho: f64) -> f64 {
        self.specular + self.gain * rho / (1.0 - self.returned * rho)
    }

    /// Reflectance of the base of a board with this radiance factor: the inverse of [`Self::apparent`].
    pub fn reflectance(&self, apparent: f64) -> f64 {
        let diffuse = apparent - self.specular;
        diffuse / (self.gain + self.returned * diffuse)
    }
}

/// The base of a scene as seen in photographs without a slab.
///
/// ρ of a base is derived from these photographs, through the scene. So it changes with the assumed coat and lamps.
#[derive(Debug)]
pub struct SeenBase<'a> {
    scene: &'a Scene,
    /// The scene's board, computed on demand.
    board: OnceCell<BareBoard>,
}

impl<'a> SeenBase<'a> {
    pub fn of(scene: &'a Scene) -> Self {
        Self { scene, board: OnceCell::new() }
    }

    /// The channels of a varied scene: the reflectances at which its base has the radiance factors that its own ρ would have
    /// in the scene. Reflectances are clamped to the range of a channel.
    pub fn through(&self, varied: &Scene) -> Result<Vec<Channel>, Invalid> {
        let scene = self.scene;
        if coat(scene)? == coat(varied)?
            && (scene.light(), scene.sensor().polar_deg()) == (varied.light(), varied.sensor().polar_deg())
        {
            return Ok(varied.channels().to_vec());
        }
        let other = BareBoard::of(varied)?;
        let known = self.board.get().copied().map_or_else(|| BareBoard::of(scene), Ok)?;
        self.board.get_or_init(|| known);
        let rho = |rho: f64, least: f64| other.reflectance(known.apparent(rho)).clamp(least, 1.0);
        let channel =
            |c: &Channel| Channel::new(c.name(), rho(c.rho_light(), 0.0), rho(c.rho_dark(), LEAST_RHO_DARK));
        varied.channels().iter().map(channel).collect()
    }

    /// Standard errors of ρ (light, dark) of each channel due to the priors of all but the base: the root of the sum of
    /// squares of the changes that one standard deviation of each prior makes.
    pub fn std_errors(&self) -> Result<Vec<[f64; 2]>, Invalid> {
        let channels = self.scene.channels();
        let mut squares = vec![[0.0; 2]; channels.len()];
        for prior in self.scene.priors().iter().filter(|prior| !prior.kind().is_of_base()) {
            let varied = |sd: f64| self.scene.varied(prior, sd * prior.std_error(), channels.to_vec());
            let changed = self.through(&varied(1.0).or_else(|_| varied(-1.0))?)?;
            for (square, (changed, known)) in squares.iter_mut().zip(changed.iter().zip(channels)) {
                square[0] += (changed.rho_light() - known.rho_light()).powi(2);
                square[1] += (changed.rho_dark() - known.rho_dark()).powi(2);
            }
        }
        Ok(squares.into_iter().map(|sides| sides.map(f64::sqrt)).collect())
    }
}

/// Means over the points of a sequence, added up in a fixed order.
fn means<const N: usize>(points: u32, f: impl Fn(FacePoint) -> [f64; N] + Sync) -> [f64; N] {
    const PART: u32 = 1 << 12;
    let add = |a: [f64; N], b: [f64; N]| std::array::from_fn(|i| a[i] + b[i]);
    let point_values = |i: u32| f(FacePoint::new(i, points));
    let part = |part: u32| (part * PART..(part + 1) * PART).map(point_values).fold([0.0; N], add);
    let parts: Vec<[f64; N]> = (0..points / PART).into_par_iter().map(part).collect();
    parts.into_iter().fold([0.0; N], add).map(|sum| sum / f64::from(points))
}

/// Share of the light in the directions that count.
fn share(rays: &FaceRays, counts: impl Fn(Vec3) -> bool) -> f64 {
    rays.iter().flatten().filter(|ray| counts(ray.0)).map(|ray| ray.1).sum()
}

/// The coat of a scene's base, with air above; None if it has none.
fn coat(scene: &Scene) -> Result<Option<Face>, Invalid> {
    let coats: Vec<(f64, f64)> = scene
        .layers()
        .iter()
        .rev()
        .map_while(|layer| match layer.medium() {
            LayerMedium::Clear { ior, thickness_mm: 0.0 } => Some((ior, layer.roughness())),
            _ => None,
        })
        .collect();
    match coats.as_slice() {
        [] => Ok(None),
        [(ior, roughness)] => Ok(Some(Face {
            iors: [1.0, *ior],
            roughness: *roughness,
            multiple_scattering: scene.multiple_scattering(),
        })),
        several => {
            let given = format!("{} coats on the base", several.len());
            Err(Invalid::new("layer", given, "at most one layer of no thickness may lie on the base"))
        }
    }
}

#[cfg(test)]
mod tests {
    use optics_model::scene::{Layer, RingLight, Sensor};

    use super::*;
    use crate::fresnel::RelativeIndex;
    use crate::math::unit_vector;
    use crate::microfacet::scatter_once;
    use crate::rng::{Stream, uniform};
    use crate::testing::fresnel;

    fn coated(roughness: f64) -> Scene {
        let layers =
            vec![Layer::sample("sample", 0.0).unwrap(), Layer::clear("coat", 1.49, 0.0, roughness).unwrap()];
        let paper = Scene::paper();
        Scene::new(layers, paper.channels().to_vec(), paper.light(), paper.sensor(), false).unwrap()
    }

    /// ∫ f(sin² θ) d sin² θ over a range, with 200,000 points.
    fn integral(from: f64, to: f64, f: impl Fn(f64) -> f64) -> f64 {
        let n = 200_000;
        let step = (to - from) / f64::from(n);
        (0..n).map(|i| f(from + (f64::from(i) + 0.5) * step) * step).sum()
    }

    /// The quantities of a smooth coat match integrals of Fresnel's formulas.
    #[test]
    fn smooth_coat_matches_fresnel_integrals() {
        let n = 1.49_f64;
        let board = BareBoard::of(&coated(0.0)).unwrap();
        let returned = integral(0.0, 1.0, |s| fresnel((1.0 - s).sqrt(), n));
        let (inner, outer) = (sin2(40.0), sin2(50.0));
        let lit = integral(inner, outer, |s| 1.0 - fresnel((1.0 - s).sqrt(), 1.0 / n)) / (outer - inner);
        let gain = (1.0 - fresnel(1.0, 1.0 / n)) * lit / (n * n);
        assert_eq!(board.specular, 0.0);
        assert!((board.returned - returned).abs() < 5e-5, "{} {returned}", board.returned);
        assert!((board.gain - gain).abs() < 2e-6, "{} {gain}", board.gain);
        // In a closed furnace nothing is lost: a white base under a smooth coat sends all light back.
        let furnace = coated(0.0).with_light(RingLight::new(0.0, 90.0).unwrap());
        let seen = BareBoard::of(&furnace).unwrap().apparent(1.0);
        assert!((seen - 1.0).abs() < 2e-4, "{seen}");
    }

    /// The share that a lossless coat sends back to the base, from what passes it from above, is what a sum from below
    /// gives, within the accuracy of the module. That sum has more noise, so it has eight times as many points.
    #[test]
    fn both_sides_return_the_same_light() {
        let scene = coated(0.15).with_multiple_scattering(true);
        let coat = coat(&scene).unwrap().unwrap();
        let [direct] =
            means(8 * POINTS, |point| [share(&coat.rays(FaceSide::Below, point.u, point), |d| d.z > 0.0)]);
        let returned = BareBoard::of(&scene).unwrap().returned;
        assert!((returned - direct).abs() < 1e-4, "{returned} {direct}");
    }

    /// The radiance factor of a base without a coat is its reflectance.
    #[test]
    fn uncoated_base_keeps_its_reflectance() {
        let board = BareBoard::of(&Scene::smooth()).unwrap();
        assert_eq!(board.apparent(0.5), 0.5);
    }

    /// A smooth coat reflects the ring light into the camera if the mirror direction of the view lies in the ring.
    #[test]
    fn mirror_shows_the_ring_in_view() {
        let scene = coated(0.0).with_sensor(Sensor::new(10.0, 360, 45.0).unwrap());
        let expected = fresnel(libm::cos(45_f64.to_radians()), 1.0 / 1.49) / (sin2(50.0) - sin2(40.0));
        assert!((BareBoard::of(&scene).unwrap().specular - expected).abs() < 1e-5);
    }

    /// The board's three numbers by plain walks through the tracer's interface: 4 million for each, 4 standard errors. With
    /// 200 million they are 0.01156, 0.4077 and 0.52222, of which the last two digits are uncertain.
    #[test]
    fn rough_coat_agrees_with_walks() {
        let (alpha, n) = (0.15, 1.49);
        let board = BareBoard::of(&coated(0.15)).unwrap();
        let (above, below) = (RelativeIndex::new(1.0, n), RelativeIndex::new(n, 1.0));
        let (inner, outer) = (sin2(40.0) as f32, sin2(50.0) as f32);
        let walks = 4_000_000_u32;
        let sums = (0..walks)
            .into_par_iter()
            .map(|walk| {
                let mut stream = Stream::new([41, 43], 0, walk);
                let in_ring = |d: Vec3| (inner..=outer).contains(&(d.x * d.x + d.y * d.y));
                let entered = scatter_once(Vec3::Z, alpha, above, stream.words());
                let words = stream.words();
                let (u, (c, s)) = (uniform(words[0]), unit_vector(words[1]));
                let wi = Vec3::new(u.sqrt() * c, u.sqrt() * s, (1.0 - u).sqrt());
                let left = scatter_once(wi, alpha, below, stream.words());
                let weight = |out: Option<crate::microfacet::Scattered>, counts: &dyn Fn(Vec3) -> bool| {
                    out.filter(|s| counts(s.direction)).map_or(0.0, |s| f64::from(s.weight))
                };
                [
                    weight(entered, &|d| d.z > 0.0 && in_ring(d)),
                    weight(entered, &|d| d.z < 0.0),
                    weight(left, &|d| d.z < 0.0 && in_ring(d)),
                    weight(left, &|d| d.z > 0.0),
                ]
            })
            .reduce(|| [0.0; 4], |a, b| [a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]]);
        let [specular, enter, leave, returned] = sums.map(|sum| sum / f64::from(walks));
        let ring = sin2(50.0) - sin2(40.0);
        let error = |p: f64| 4.0 * (p / f64::from(walks)).sqrt();
        assert!((board.specular - specular / ring).abs() < error(specular) / ring);
        let gain = enter * leave / ring;
        assert!((board.gain - gain).abs() < error(leave) / ring, "{} {gain}", board.gain);
        assert!((board.returned - returned).abs() < error(returned), "{} {returned}", board.returned);
    }

    /// The 200 million walks of the test above give 0.8385 ± 0.0003 and 0.02147 ± 0.00002.
    #[test]
    fn paper_board_looks_darker_than_it_is() {
        let board = BareBoard::of(&Scene::paper()).unwrap();
        assert!((board.apparent(0.985) - 0.8386).abs() < 1e-4, "{}", board.apparent(0.985));
        assert!((board.apparent(0.024) - 0.02144).abs() < 2e-5, "{}", board.apparent(0.024));
    }

    /// A dark base under a rougher coat has ρ < 0, at which its radiance factor is unchanged.
    #[test]
    fn dark_board_keeps_its_appearance() {
        let channel = Channel::new("K", 0.95, 0.005).unwrap();
        let lab = Scene::lab().with_channels(vec![channel]).unwrap();
        let coat = lab.priors()[1].clone();
        let varied = lab.varied(&coat, coat.std_error(), lab.channels().to_vec()).unwrap();
        let base = SeenBase::of(&lab);
        let [found] = base.through(&varied).unwrap().try_into().unwrap();
        assert!((-0.010..-0.008).contains(&found.rho_dark()), "{found:?}");
        let appears = BareBoard::of(&varied).unwrap().apparent(found.rho_dark());
        let appeared = BareBoard::of(&lab).unwrap().apparent(0.005);
        assert!((appears - appeared).abs() < 1e-9, "{appears} {appeared}");
        // Coat and ring are uncertain; the roughness of the coat contributes most.
        let [[_, dark]] = base.std_errors().unwrap().try_into().unwrap();
        assert!((0.0139..0.02).contains(&dark), "{dark}");
    }

    /// Light that is followed until it leaves is not lost.
    #[test]
    fn multiple_scattering_loses_no_light() {
        let furnace =
            coated(0.3).with_light(RingLight::new(0.0, 90.0).unwrap()).with_multiple_scattering(true);
        let seen = BareBoard::of(&furnace).unwrap().apparent(1.0);
        assert!((seen - 1.0).abs() < 2e-4, "{seen}");
    }
}
