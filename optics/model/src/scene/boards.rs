//! Boards at which a dictionary is traced so that it serves every board: a profile is a smooth function of the two
//! reflectances, and all boards share their walks, so that interpolation between them adds no noise to speak of.
//!
//! A walk that meets the base k times on its light side and m times on its dark side contributes ρ_light^k ρ_dark^m. The
//! function is interpolated by polynomials of a total degree of at most 3, on a lattice of reflectances (combination of
//! differences of Lagrange's formula, as in Smolyak 1963).

use std::ops::RangeInclusive;

use super::{Channel, Scene};
use crate::invalid::{Invalid, Result};

/// Reflectances of the light side and of the dark side, in the order in which a degree is added.
const LIGHT: [f64; 4] = [0.985, 0.9, 0.955, 0.86];
const DARK: [f64; 3] = [0.03, 0.0, 0.06];
/// Greatest total degree.
const DEGREE: usize = 3;
/// Reflectances that are served.
const SERVED_LIGHT: RangeInclusive<f64> = 0.85..=1.0;
const SERVED_DARK: RangeInclusive<f64> = -0.02..=0.08;

/// Places on the lattice, in the order of their channels.
fn lattice() -> impl Iterator<Item = (usize, usize)> {
    let places = (0..LIGHT.len()).flat_map(|i| (0..DARK.len()).map(move |j| (i, j)));
    places.filter(|(i, j)| i + j <= DEGREE)
}

fn name(number: usize) -> String {
    format!("board {}", number + 1)
}

impl Channel {
    /// The weights of the channels of a scene for all boards that give the profile over this channel's board.
    pub fn board_weights(&self) -> Vec<f64> {
        let weight = |(a, b): (usize, usize)| -> f64 {
            let of = |(i, j): (usize, usize)| {
                increment(&LIGHT, i, a, self.rho_light()) * increment(&DARK, j, b, self.rho_dark())
            };
            lattice().map(of).sum()
        };
        lattice().map(weight).collect()
    }

    fn check_served(&self) -> Result<()> {
        for (field, rho, served) in
            [("rho_light", self.rho_light(), SERVED_LIGHT), ("rho_dark", self.rho_dark(), SERVED_DARK)]
        {
            if !served.contains(&rho) {
                let allowed =
                    format!("a dictionary for all boards serves {} to {}", served.start(), served.end());
                return Err(Invalid::new(field, rho, allowed));
            }
        }
        Ok(())
    }
}

impl Scene {
    /// This scene over boards that serve its own channels, too. Refused where the indices depend on the wavelengths of
    /// channels, and for boards beyond the lattice.
    pub fn for_all_boards(&self) -> Result<Self> {
        check_boards("channel", self.channels())?;
        if self.priors().iter().any(|prior| prior.dispersion().is_some()) {
            let allowed = "a dictionary for all boards has no wavelengths";
            return Err(Invalid::new("dispersion", "an index of the scene", allowed));
        }
        let board = |(number, (i, j)): (usize, (usize, usize))| Channel::new(name(number), LIGHT[i], DARK[j]);
        self.clone().with_channels(lattice().enumerate().map(board).collect::<Result<_>>()?)
    }

    /// Whether its channels are those of a scene for all boards.
    pub fn is_for_all_boards(&self) -> bool {
        let is_board = |(number, channel): (usize, &Channel)| channel.name() == name(number);
        self.channels().len() == lattice().count() && self.channels().iter().enumerate().all(is_board)
    }
}

/// Refuses boards that a dictionary for all boards does not serve; `field` is the name of their list.
pub(crate) fn check_boards(field: &str, channels: &[Channel]) -> Result<()> {
    let check = |(i, channel): (usize, &Channel)| {
        channel.check_served().map_err(|e| e.within(format_args!("{field}[{i}]")))
    };
    channels.iter().enumerate().try_for_each(check)
}

/// Weight of a node in the difference that the node `last` makes to the interpolation by those before it.
fn increment(nodes: &[f64], last: usize, node: usize, x: f64) -> f64 {
    let weight = |count: usize| -> f64 {
        if node >= count {
            return 0.0;
        }
        let others = (0..count).filter(|k| *k != node);
        others.map(|k| (x - nodes[k]) / (nodes[node] - nodes[k])).product()
    };
    weight(last + 1) - weight(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Polynomials up to the degree are reproduced, and light that is reflected again and again is to 2·10⁻⁵.
    #[test]
    fn weights_reproduce_what_boards_show() {
        let boards = Scene::lab().for_all_boards().unwrap();
        assert!(boards.is_for_all_boards() && !Scene::lab().is_for_all_boards());
        let worst = |f: &dyn Fn(f64, f64) -> f64, rho: [f64; 2]| {
            let weights = Channel::new("R", rho[0], rho[1]).unwrap().board_weights();
            let of_board = |c: &Channel| f(c.rho_light(), c.rho_dark());
            let sum: f64 = boards.channels().iter().zip(&weights).map(|(c, w)| w * of_board(c)).sum();
            (sum - f(rho[0], rho[1])).abs()
        };
        for rho in [[0.985, 0.024], [0.93, 0.0], [0.87, 0.07], [1.0, -0.01], [0.955, 0.05]] {
            for (i, j) in lattice() {
                let off = worst(&|l, d| l.powi(i as i32) * d.powi(j as i32), rho);
                assert!(off < 1e-12, "{rho:?} {i} {j}: {off}");
            }
            // Through a bright slab, which sends half of the base's light back to it.
            for share in [0.0, 0.3, 0.7, 1.0] {
                let mean = |l: f64, d: f64| share * l + (1.0 - share) * d;
                let off = worst(&|l, d| 0.3 * mean(l, d) / (1.0 - 0.5 * mean(l, d)), rho);
                assert!(off < 5e-5, "{rho:?} {share}: {off}");
            }
        }
    }

    /// Boards beyond the lattice are refused, and so are scenes whose channels are wavelengths that matter.
    #[test]
    fn boards_beyond_the_lattice_are_refused() {
        let with = |light, dark| {
            let channel = Channel::new("R", light, dark).unwrap();
            Scene::lab().with_channels(vec![channel]).unwrap().for_all_boards()
        };
        assert_eq!(with(0.8, 0.02).unwrap_err().field(), "channel[0].rho_light");
        assert_eq!(with(0.9, 0.1).unwrap_err().field(), "channel[0].rho_dark");
        assert!(with(0.9, 0.02).is_ok());
    }
}
