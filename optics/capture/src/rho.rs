//! Computes the board's reflectance from its appearance in the scene.
//!
//! A base of reflectance ρ under layers appears as s + a ρ/(1 − b ρ): s is the reflection of the layers themselves, a
//! the transmission in and out, b the reflection back onto the base.

use optics_model::Invalid;
use optics_model::scene::DARKER_WHITE;

use crate::board::Board;
use crate::estimate::Estimate;

/// Appearance of an even base of any reflectance ρ in the scene: s + a ρ/(1 − b ρ).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Appearance {
    pub s: f64,
    pub a: f64,
    pub b: f64,
}

/// Reflectances of both sides of the edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardRho {
    pub light: Estimate,
    pub dark: Estimate,
    /// Light and dark, if the white reference had [`DARKER_WHITE`] of its reflectance.
    pub under_darker_white: [f64; 2],
}

impl Appearance {
    /// ρ = y/(a + b y), y = v − s.
    pub fn rho(&self, apparent: Estimate) -> Estimate {
        let y = apparent.value - self.s;
        let below = self.a + self.b * y;
        Estimate::new(y / below, apparent.std_error * self.a / (below * below))
    }
}

impl Board {
    /// ρ of both sides. `gain_std_error` is the relative error of the white reference, common to both.
    pub fn rho(&self, shown: &[Appearance; 3], gain_std_error: f64) -> Result<[BoardRho; 3], Invalid> {
        let of = |c: usize| {
            let sides = [self.light[c], self.dark[c]];
            let with = |e: Estimate| Estimate::new(e.value, e.std_error.hypot(gain_std_error * e.value));
            let [light, dark] = sides.map(|seen| shown[c].rho(with(seen)));
            let darker = |seen: Estimate| Estimate::new(DARKER_WHITE * seen.value, seen.std_error);
            BoardRho { light, dark, under_darker_white: sides.map(|seen| shown[c].rho(darker(seen)).value) }
        };
        let found = [of(0), of(1), of(2)];
        for (c, rho) in found.iter().enumerate() {
            for (side, estimate) in [("light", rho.light), ("dark", rho.dark)] {
                let within = -3.0 * estimate.std_error..=1.0 + 3.0 * estimate.std_error;
                if !within.contains(&estimate.value) {
                    let field = format!("rho.{side}[{}]", crate::Colour::ALL[c].letter());
                    let allowed = "from 0 to 1; the scene or the white reference does not fit this board";
                    return Err(Invalid::new(field, format!("{:.4}", estimate.value), allowed));
                }
            }
        }
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ρ is recovered from the apparent brightness, with its error.
    #[test]
    fn rho_is_recovered_with_its_error() {
        let shown = Appearance { s: 0.004, a: 0.55, b: 0.45 };
        let apparent = |rho: f64| shown.s + shown.a * rho / (1.0 - shown.b * rho);
        let found = shown.rho(Estimate::new(apparent(0.985), 1e-3));
        assert!((found.value - 0.985).abs() < 1e-12);
        let slope = (apparent(0.986) - apparent(0.984)) / 0.002;
        assert!((found.std_error * slope / 1e-3 - 1.0).abs() < 1e-4, "{found:?}");
        // With a reference that reflects 1 % less, the board is 1 % darker than assumed.
        let darker = shown.rho(Estimate::new(DARKER_WHITE * apparent(0.985), 1e-3)).value;
        assert!((apparent(darker) / apparent(0.985) - DARKER_WHITE).abs() < 1e-12, "{darker}");
    }
}
