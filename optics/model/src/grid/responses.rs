//! Plans the responses of profiles to the uncertain quantities of a scene: some transport points of a grid are traced
//! again in scenes in which one quantity has another value.
//!
//! They have the seeds of the grid's own points, so that both follow the same random walks as far as possible: the
//! difference of two such records has little noise. It is smooth in σ_t and g, so every few nodes of these axes suffice.
//! Where a quantity changes the course of a walk, differences are noisy nevertheless: such variants have several times
//! the walks, and so has the *baseline* that their records are compared with, the scene itself at the same nodes.

use std::sync::Arc;

use super::Axes;
use crate::invalid::{Invalid, Result};
use crate::medium::check_ior;
use crate::scene::{Channel, Prior, Scene};

/// Widest ratio of two extinctions of the responses, unless the grid's are farther apart.
const SIGMA_T_RATIO: f64 = 2.0;
/// Most anisotropies of the responses.
const MOST_G: usize = 3;
/// Walks of the baseline and of the variants compared with it, over those of the grid's own points.
const WALKS_FACTOR: u32 = 3;
/// Most steps of a quantity.
const MOST_STEPS: usize = 4;
/// Largest accepted walks factor.
const MOST_WALKS_FACTOR: u32 = 100;

/// A scene in which one quantity has another value.
#[derive(Debug, Clone, PartialEq)]
pub struct Variant {
    /// Index into the scene's priors.
    pub prior: usize,
    /// Difference of the quantity from the scene's value.
    pub step: f64,
    /// The channels of the base in the varied scene: their ρ follow from photographs without a slab, through that scene.
    pub channels: Vec<Channel>,
}

/// The variants of a grid's scene, and the nodes of the axes at which they are traced.
#[derive(Debug, Clone, PartialEq)]
pub struct Responses {
    variants: Vec<Variant>,
    scenes: Vec<Arc<Scene>>,
    sigma_t: Vec<usize>,
    g: Vec<usize>,
    walks_factor: u32,
    /// Whether each variant is compared with the baseline.
    by_baseline: Vec<bool>,
}

impl Responses {
    /// For all uncertain quantities of a scene; None if there are none. `base` returns the channels of a varied scene.
    pub fn of(
        scene: &Scene,
        axes: &Axes,
        base: impl Fn(&Scene) -> Result<Vec<Channel>>,
    ) -> Result<Option<Self>> {
        let mut variants = Vec::new();
        for (index, prior) in scene.priors().iter().enumerate() {
            for step in prior.steps(scene) {
                let channels = base(&scene.varied(prior, step, scene.channels().to_vec())?)?;
                variants.push(Variant { prior: index, step, channels });
            }
        }
        if variants.is_empty() {
            return Ok(None);
        }
        Self::new(scene, axes, variants, WALKS_FACTOR).map(Some)
    }

    /// From variants: the steps of every prior of the scene, in their order. They need not be those of
    /// [`crate::scene::Prior::steps`], since dictionaries of earlier versions have others. A factor of 1 needs no baseline.
    pub fn new(scene: &Scene, axes: &Axes, variants: Vec<Variant>, walks_factor: u32) -> Result<Self> {
        if !(1..=MOST_WALKS_FACTOR).contains(&walks_factor) {
            let allowed = format!("allowed are 1 to {MOST_WALKS_FACTOR}");
            return Err(Invalid::new("response_walks_factor", walks_factor, allowed));
        }
        check_steps(scene.priors(), &variants)?;
        let names = |channels: &[Channel]| channels.iter().map(|c| c.name().to_owned()).collect::<Vec<_>>();
        let scene_of = |(i, variant): (usize, &Variant)| {
            let at = |e: Invalid| e.within(format_args!("responses[{i}]"));
            if names(&variant.channels) != names(scene.channels()) {
                let given = names(&variant.channels).join(", ");
                return Err(at(Invalid::new(
                    "channels",
                    given,
                    "the channels of the scene are needed, in their order",
                )));
            }
            let prior = &scene.priors()[variant.prior];
            let own_iors = axes.sample_ior.iter().filter(|_| prior.is_sample_index(scene));
            own_iors
                .map(|ior| check_ior("sample_ior", ior + variant.step))
                .collect::<Result<Vec<_>>>()
                .map_err(at)?;
            let varied = scene.varied(prior, variant.step, scene.channels().to_vec());
            varied.and_then(|s| s.with_channels(variant.channels.clone())).map(Arc::new).map_err(at)
        };
        let scenes: Vec<Arc<Scene>> = variants.iter().enumerate().map(scene_of).collect::<Result<_>>()?;
        let g = spread_anisotropies(&axes.g, &scenes)?;
        let redraws = |variant: &Variant| scene.priors()[variant.prior].kind().redraws_walks();
        Ok(Self {
            by_baseline: variants.iter().map(|variant| walks_factor > 1 && redraws(variant)).collect(),
            walks_factor,
            variants,
            scenes,
            sigma_t: spread_extinctions(&axes.sigma_t_per_mm),
            g,
        })
    }

    pub fn variants(&self) -> &[Variant] {
        &self.variants
    }

    /// Differences of a quantity from the scene's value at which it was traced.
    pub fn steps_of(&self, prior: usize) -> Vec<f64> {
        steps_of(&self.variants, prior)
    }

    /// The scene of a variant.
    pub fn scene(&self, variant: usize) -> &Arc<Scene> {
        &self.scenes[variant]
    }

    /// Walks of the baseline and of the variants compared with it, over those of the grid's own points; 1 without a
    /// baseline.
    pub fn walks_factor(&self) -> u32 {
        self.walks_factor
    }

    /// Whether a variant is compared with the baseline instead of the records of the axes.
    pub fn is_by_baseline(&self, variant: usize) -> bool {
        self.by_baseline[variant]
    }

    /// The variants, then the baseline if there is one.
    pub fn traced(&self) -> impl ExactSizeIterator<Item = Option<usize>> {
        let count = self.variants.len();
        (0..count + usize::from(self.has_baseline())).map(move |i| (i < count).then_some(i))
    }

    fn has_baseline(&self) -> bool {
        self.by_baseline.contains(&true)
    }

    /// Indices into the grid's extinctions.
    pub fn sigma_t(&self) -> &[usize] {
        &self.sigma_t
    }

    /// Indices into the grid's anisotropies.
    pub fn g(&self) -> &[usize] {
        &self.g
    }
}

fn steps_of(variants: &[Variant], prior: usize) -> Vec<f64> {
    variants.iter().filter(|v| v.prior == prior).map(|v| v.step).collect()
}

fn check_steps(priors: &[Prior], variants: &[Variant]) -> Result<()> {
    let is_allowed = |steps: Vec<f64>| {
        (1..=MOST_STEPS).contains(&steps.len())
            && steps.iter().all(|step| step.is_finite())
            && steps.iter().any(|step| *step != 0.0)
            && steps.is_sorted_by(|a, b| a < b)
    };
    let in_order = variants.is_sorted_by_key(|v| v.prior) && variants.iter().all(|v| v.prior < priors.len());
    let is_right = |(index, prior): (usize, &Prior)| match steps_of(variants, index) {
        steps if prior.kind().is_traced() => is_allowed(steps),
        steps => steps.is_empty(),
    };
    if in_order && priors.iter().enumerate().all(is_right) {
        return Ok(());
    }
    let given: Vec<_> = variants.iter().map(|v| (v.prior, v.step)).collect();
    let allowed = format!(
        "each of the scene's {} priors that are traced needs (prior, step) with one step, not 0, or up to {MOST_STEPS} that rise",
        priors.len()
    );
    Err(Invalid::new("responses", format!("{given:?}"), allowed))
}

/// The nodes next to evenly spread logarithms, both ends included.
fn spread_extinctions(axis: &[f64]) -> Vec<usize> {
    let logs: Vec<f64> = axis.iter().map(|v| libm::log(*v)).collect();
    let span = (logs[logs.len() - 1] - logs[0]) / libm::log(SIGMA_T_RATIO);
    spread(&logs, span.round() as usize + 1)
}

/// The nodes next to evenly spread ln(1 − g), both ends included, among those that are possible in all scenes: a heavy
/// second lobe excludes large mean cosines.
fn spread_anisotropies(axis: &[f64], scenes: &[Arc<Scene>]) -> Result<Vec<usize>> {
    let in_scenes = |g: &f64| scenes.iter().try_for_each(|s| s.phase().function(*g).map(|_| ()));
    let possible: Vec<usize> = (0..axis.len()).filter(|i| in_scenes(&axis[*i]).is_ok()).collect();
    if possible.is_empty() {
        in_scenes(&axis[0]).map_err(|e| {
            let allowed = format!("the response of the second lobe would be traced there: {}", e.allowed());
            Invalid::new("g", e.given(), allowed)
        })?;
    }
    let logs: Vec<f64> = possible.iter().map(|i| -libm::log(1.0 - axis[*i])).collect();
    Ok(spread(&logs, MOST_G).into_iter().map(|i| possible[i]).collect())
}

/// Indices of the rising nodes that are nearest to `count` evenly spread places, each once.
fn spread(nodes: &[f64], count: usize) -> Vec<usize> {
    let (first, last) = (nodes[0], nodes[nodes.len() - 1]);
    let count = count.max(if nodes.len() > 1 { 2 } else { 1 });
    let place = |i: usize| first + (last - first) * i as f64 / (count - 1).max(1) as f64;
    let nearest = |x: f64| {
        let off = |i: &usize| (nodes[*i] - x).abs();
        (0..nodes.len()).min_by(|a, b| off(a).total_cmp(&off(b))).expect("an axis is not empty")
    };
    let mut indices: Vec<usize> = (0..count).map(|i| nearest(place(i))).collect();
    indices.dedup();
    indices
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{Grid, Walks};
    use crate::job::JobSpec;

    fn lab() -> Grid {
        let (scene, axes) = (Scene::lab(), Grid::paper().axes().clone());
        let responses = Responses::of(&scene, &axes, |s| Ok(s.channels().to_vec())).unwrap();
        let grid = Grid::new(scene, axes, Walks::new(1000).unwrap(), 1, false).unwrap();
        grid.with_responses(responses.unwrap()).unwrap()
    }

    /// Responses of the paper's grid are traced at 6 extinctions and 3 anisotropies.
    #[test]
    fn responses_are_traced_at_few_nodes() {
        let grid = lab();
        let responses = grid.responses().unwrap();
        let sigma_t: Vec<f64> = responses.sigma_t().iter().map(|i| grid.sigma_t_per_mm()[*i]).collect();
        assert_eq!(sigma_t, [1.0, 2.0, 4.0, 7.5, 15.0, 30.0]);
        assert_eq!(responses.g().iter().map(|i| grid.g()[*i]).collect::<Vec<_>>(), [0.0, 0.55, 0.8]);
        assert_eq!(responses.variants().len(), 24);
        // The variants and the baseline.
        assert_eq!((grid.nominal_jobs(), grid.job_count()), (836, 836 + 25 * 6 * 3 * 2));
        assert_eq!(spread(&[1.0], 3), [0]);
        assert_eq!(spread(&[1.0, 1.1], 3), [0, 1]);
    }

    /// A job of a variant has the point and the seed of the grid's own job, and another scene. If it is compared with the
    /// baseline, both have three times the walks.
    #[test]
    fn jobs_of_variants_follow_the_nominal_ones() {
        let grid = lab();
        let responses = grid.responses().unwrap();
        let mut seen = std::collections::BTreeSet::new();
        for job in grid.nominal_jobs()..grid.job_count() {
            let place = grid.response_of(job).unwrap();
            let nominal = JobSpec::of(&grid, place.nominal_job);
            let spec = JobSpec::of(&grid, job);
            assert_eq!((spec.point(), spec.seed()), (nominal.point(), nominal.seed()));
            let more = place.variant.is_none_or(|variant| responses.is_by_baseline(variant));
            assert_eq!(spec.walks().get(), nominal.walks().get() * if more { 3 } else { 1 });
            assert_eq!(spec.scene(), place.variant.map_or(grid.scene(), |v| &**responses.scene(v)));
            assert_ne!(spec.identity(), nominal.identity());
            assert_eq!(grid.response_job(place.variant, place.nominal_job), Some(job));
            assert!(seen.insert((place.variant, place.nominal_job)), "each once");
        }
        // Roughnesses, indices and the second lobe, and the baseline.
        let more = (0..24).filter(|v| responses.is_by_baseline(*v)).count();
        assert_eq!((more, seen.len()), (12, 25 * 36));
        assert_eq!(grid.response_of(5), None);
        assert_eq!(
            grid.response_job(Some(0), grid.job_at(&grid.point(3)).unwrap()),
            grid.response_job(Some(0), 3)
        );
    }

    /// Responses with the walks of the grid's own points have no baseline.
    #[test]
    fn factor_of_one_needs_no_baseline() {
        let grid = lab();
        let with_factor = |factor| {
            let variants = grid.responses().unwrap().variants().to_vec();
            Responses::new(grid.scene(), grid.axes(), variants, factor)
        };
        let plain = Grid { responses: None, ..grid.clone() };
        let single = plain.with_responses(with_factor(1).unwrap()).unwrap();
        assert_eq!(single.job_count(), 836 + 24 * 36);
        assert!((836..single.job_count()).all(|job| single.walks_of(job).get() == 1000));
        assert_eq!(single.response_job(None, 0), None);
        for bad in [0, 101] {
            let error = with_factor(bad).unwrap_err().to_string();
            assert!(error.ends_with("is not valid: allowed are 1 to 100"), "{error}");
        }
    }

    /// Responses are traced at the anisotropies that are possible with the heaviest second lobe.
    #[test]
    fn heavy_second_lobe_limits_the_nodes() {
        let (scene, mut axes) = (Scene::lab(), Grid::paper().axes().clone());
        let nodes = |axes: &Axes| {
            let responses = Responses::of(&scene, axes, |s| Ok(s.channels().to_vec())).unwrap().unwrap();
            responses.g().iter().map(|i| axes.g[*i]).collect::<Vec<_>>()
        };
        axes.g = vec![0.0, 0.3, 0.5, 0.8, 0.85, 0.9];
        assert_eq!(nodes(&axes), [0.0, 0.5, 0.8]);
        axes.g = vec![0.9];
        let error = Responses::of(&scene, &axes, |s| Ok(s.channels().to_vec())).unwrap_err().to_string();
        assert!(error.starts_with("g = 0.9 is not valid: the response of the second lobe"), "{error}");
        axes.g = vec![0.0, 0.95];
        let error = Grid::new(scene.clone(), axes, Walks::PAPER, 1, false).unwrap_err().to_string();
        assert!(error.starts_with("g[1] = 0.95 is not valid: with a second lobe of weight 0.05"), "{error}");
    }

    /// Every prior that is traced has its steps, which need not be those that a plan has today.
    #[test]
    fn every_prior_has_its_steps() {
        let grid = lab();
        // The last is the ring, with two steps, but for haze without any.
        let is_kept = |prior: &&Prior| !prior.kind().is_of_base();
        let priors: Vec<Prior> = grid.scene().priors().iter().filter(is_kept).cloned().collect();
        let ring = priors.len() - 2;
        let scene = grid.scene().clone().with_priors(priors).unwrap();
        let all = grid.responses().unwrap().variants();
        let variants: Vec<Variant> = all.iter().filter(|v| v.prior <= ring).cloned().collect();
        let last = variants.len() - 1;
        let with = |change: fn(&mut Vec<Variant>, usize)| {
            let mut changed = variants.clone();
            change(&mut changed, last);
            Responses::new(&scene, grid.axes(), changed, 3)
        };
        let refused = |change| assert_eq!(with(change).unwrap_err().field(), "responses");
        assert!(with(|v, last| v[last].step = 2.0).is_ok());
        assert!(with(Vec::truncate).is_ok());
        refused(|v, last| v.truncate(last - 1));
        refused(|v, _| v.swap(1, 2));
        refused(|v, last| v[last].prior += 1);
        refused(|v, last| v[last].step = v[last - 1].step);
        refused(|v, last| v[last].step = 2.0 * v[last - 1].step);
        refused(|v, last| {
            v.truncate(last);
            v[last - 1].step = 0.0;
        });
        refused(|v, last| v[last].step = f64::NAN);
        refused(|v, last| v.push(Variant { prior: v[last].prior + 1, ..v[last].clone() }));
    }
}
