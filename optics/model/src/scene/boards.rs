//! Boards at which a dictionary is traced so that it serves every board: a profile is a smooth function of the two
//! reflectances, and all boards share their walks, so that interpolation between them adds no noise to speak of.
//!
//! A walk that meets the base k times on its light side and m times on its dark side contributes ρ_light^k ρ_dark^m. With
//! a share R of the light reflected back to the base, sums over k are ρ/(1 − Rρ). So the function of ρ_light is
//! interpolated by a polynomial over Π(1 − R_k ρ), that of ρ_dark by a polynomial, on a lattice of reflectances
//! (combination of differences of Lagrange's formula, as in Smolyak 1963).

use std::ops::RangeInclusive;

use super::{Channel, Scene};
use crate::invalid::{Invalid, Result};

/// Reflectances of one side, in the order in which they refine the interpolation, each from the second on with R_k.
struct SideNodes<const N: usize> {
    nodes: [f64; N],
    returned: [f64; N],
}

/// With these, ρ/(1 − Rρ) has its least error for R from 0 to 0.97, weighted with the light that reaches the base.
const LIGHT: SideNodes<5> =
    SideNodes { nodes: [0.956, 0.866, 0.9985, 0.907, 0.986], returned: [0.0, 0.925, 0.28, 0.966, 0.785] };
const DARK: SideNodes<3> = SideNodes { nodes: [0.03, 0.0, 0.06], returned: [0.0; 3] };
/// The number of light nodes at each dark one.
const LIGHT_NODES: [usize; 3] = [5, 3, 1];
/// Reflectances that are served.
const SERVED_LIGHT: RangeInclusive<f64> = 0.86..=1.0;
const SERVED_DARK: RangeInclusive<f64> = -0.01..=0.07;

/// Places on the lattice, in the order of their channels.
fn lattice() -> impl Iterator<Item = (usize, usize)> {
    LIGHT_NODES.into_iter().enumerate().flat_map(|(j, count)| (0..count).map(move |i| (i, j)))
}

fn name(number: usize) -> String {
    format!("board {}", number + 1)
}

impl Channel {
    /// The weights of the channels of a scene for all boards that give the profile over this channel's board.
    pub fn board_weights(&self) -> Vec<f64> {
        let weight = |(a, b): (usize, usize)| -> f64 {
            let product = |(i, j): (usize, usize)| {
                LIGHT.increment(i, a, self.rho_light()) * DARK.increment(j, b, self.rho_dark())
            };
            lattice().map(product).sum()
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
        let board = |(number, (i, j)): (usize, (usize, usize))| {
            Channel::new(name(number), LIGHT.nodes[i], DARK.nodes[j])
        };
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

impl<const N: usize> SideNodes<N> {
    /// Weight of a node in the difference that the node `last` makes to the interpolation by those before it.
    fn increment(&self, last: usize, node: usize, rho: f64) -> f64 {
        let before = if node < last { self.weight(last, node, rho) } else { 0.0 };
        if node <= last { self.weight(last + 1, node, rho) - before } else { 0.0 }
    }

    /// Weight of a node in the interpolation by the first `count`.
    fn weight(&self, count: usize, node: usize, rho: f64) -> f64 {
        let at = self.nodes[node];
        let lagrange = |k: usize| if k == node { 1.0 } else { (rho - self.nodes[k]) / (at - self.nodes[k]) };
        let pole = |k: usize| (1.0 - self.returned[k] * at) / (1.0 - self.returned[k] * rho);
        (0..count).map(|k| lagrange(k) * pole(k)).product()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The error of `f` between the boards.
    fn error(f: &dyn Fn(f64, f64) -> f64, [light, dark]: [f64; 2]) -> f64 {
        let boards = Scene::lab().for_all_boards().unwrap();
        let weights = Channel::new("R", light, dark).unwrap().board_weights();
        let value = |c: &Channel| f(c.rho_light(), c.rho_dark());
        let sum: f64 = boards.channels().iter().zip(&weights).map(|(c, w)| w * value(c)).sum();
        (sum - f(light, dark)).abs()
    }

    const BOARDS: [[f64; 2]; 5] = [[0.985, 0.024], [0.93, 0.0], [0.86, 0.07], [1.0, -0.01], [0.955, 0.05]];

    /// The functions of which the interpolation is a sum are reproduced.
    #[test]
    fn board_weights_reproduce_their_functions() {
        assert!(
            Scene::lab().for_all_boards().unwrap().is_for_all_boards() && !Scene::lab().is_for_all_boards()
        );
        for rho in BOARDS {
            for (i, j) in lattice() {
                let light_factor = |l: f64| if i == 0 { 1.0 } else { l / (1.0 - LIGHT.returned[i] * l) };
                let off = error(&|l, d| light_factor(l) * d.powi(j as i32), rho);
                assert!(off < 1e-11, "{rho:?} {i} {j}: {off}");
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
