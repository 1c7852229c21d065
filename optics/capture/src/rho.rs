//! Computes the board's reflectance from its appearance in the scene.
//!
//! A base of reflectance ρ under layers appears as s + a ρ/(1 − b ρ): s is the reflection of the layers themselves, a
//! the transmission in and out, b the reflection back onto the base.

use optics_model::Invalid;
use optics_model::scene::DARKER_WHITE;

use crate::board::Board;
use crate::estimate::Estimate;
use crate::frame::Colour;

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
    /// ρ of both sides in each column. `gain_std_error` is the relative error of the white reference, common to both.
    pub fn rho(&self, shown: Appearance, gain_std_error: f64) -> Vec<BoardRho> {
        let column_rho = |(light, dark): (&Estimate, &Estimate)| {
            let sides = [*light, *dark];
            let with =
                |e: Estimate| Estimate::new(e.value, libm::hypot(e.std_error, gain_std_error * e.value));
            let [light, dark] = sides.map(|seen| shown.rho(with(seen)));
            let darker = |seen: Estimate| Estimate::new(DARKER_WHITE * seen.value, seen.std_error);
            BoardRho { light, dark, under_darker_white: sides.map(|seen| shown.rho(darker(seen)).value) }
        };
        self.light.iter().zip(&self.dark).map(column_rho).collect()
    }
}

impl BoardRho {
    fn sides(&self) -> [(&'static str, Estimate); 2] {
        [("light", self.light), ("dark", self.dark)]
    }

    /// Whether both sides lie within 0 to 1, up to three standard errors of the photographs.
    pub fn is_plausible(&self) -> bool {
        self.sides().iter().all(|(_, rho)| is_possible(*rho, 0.0))
    }

    /// Refuses a side that lies outside 0 to 1 by more than three standard errors; `of_scene` are the standard errors of
    /// light and dark due to the uncertain quantities of the scene.
    pub fn check(&self, colour: Colour, of_scene: [f64; 2]) -> Result<(), Invalid> {
        for ((side, rho), of_scene) in self.sides().into_iter().zip(of_scene) {
            if !is_possible(rho, of_scene) {
                let field = format!("rho.{side}[{}]", colour.letter());
                let allowed = if rho.value < 0.0 {
                    "from 0 to 1; below 0 the board mirrors less of the lamps than the scene's coat: correct the coat's \
                     roughness in the scene, or give it a std_error"
                } else {
                    "from 0 to 1; the scene or the white reference does not fit this board"
                };
                return Err(Invalid::new(field, format!("{:.4}", rho.value), allowed));
            }
        }
        Ok(())
    }
}

/// Whether a ρ lies within 0 to 1, up to three of both standard errors.
fn is_possible(rho: Estimate, of_scene: f64) -> bool {
    let reach = 3.0 * libm::hypot(rho.std_error, of_scene);
    (-reach..=1.0 + reach).contains(&rho.value)
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

    /// The uncertain quantities of the scene widen the range of ρ; without them, a dark side of −0.002 ± 0.0001 is
    /// refused.
    #[test]
    fn scene_errors_widen_the_range_of_rho() {
        let light = Estimate::new(0.97, 1e-3);
        let rho =
            |dark: f64| BoardRho { light, dark: Estimate::new(dark, 1e-4), under_darker_white: [0.0; 2] };
        assert!(rho(-0.0002).is_plausible());
        assert!(!rho(-0.002).is_plausible());
        rho(-0.002).check(Colour::Blue, [0.0, 0.01]).unwrap();
        rho(-0.031).check(Colour::Blue, [0.0, 0.01]).unwrap_err();
        let refused = rho(-0.002).check(Colour::Blue, [0.01, 0.0]).unwrap_err();
        assert!(refused.to_string().starts_with("rho.dark[B] = -0.0020 "), "{refused}");
    }
}
