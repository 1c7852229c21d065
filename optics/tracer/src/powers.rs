//! Tables of powers, by multiplication only, so that they are the same on every machine.

/// Powers below this are taken as 0: products of two stay above the denormal numbers.
const SMALLEST: f64 = 1e-100;
const DIGIT_BITS: u32 = 6;
const DIGITS: usize = 4;
const BASE: usize = 1 << DIGIT_BITS;

/// α^n for a list of albedos and any n below 2²⁴: n in base 64, one table row per digit and value.
#[derive(Debug)]
pub struct AlbedoPowers {
    count: usize,
    /// Rows of α^(value · 64^digit), `count` albedos each.
    rows: Vec<f64>,
}

impl AlbedoPowers {
    pub fn new(albedos: &[f64]) -> Self {
        let mut rows = Vec::with_capacity(DIGITS * BASE * albedos.len());
        let mut bases = albedos.to_vec();
        for _ in 0..DIGITS {
            let mut row = vec![1.0; albedos.len()];
            for _ in 0..BASE {
                rows.extend(&row);
                for (power, base) in row.iter_mut().zip(&bases) {
                    *power = flush(*power * base);
                }
            }
            // The row now holds base^64: the next digit's base.
            bases = row;
        }
        Self { count: albedos.len(), rows }
    }

    /// Writes factor · α^n for every albedo.
    ///
    /// # Panics
    /// If n ≥ 2²⁴: roulette ends walks long before.
    #[expect(clippy::inline_always, reason = "must be compiled for the caller's instruction set")]
    #[inline(always)]
    pub fn write(&self, n: u32, factor: f64, out: &mut [f64]) {
        assert!(n < 1 << (DIGIT_BITS * DIGITS as u32), "a walk of {n} scatterings");
        out.fill(factor);
        for digit in 0..DIGITS {
            let value = (n >> (DIGIT_BITS * digit as u32)) as usize % BASE;
            if value > 0 {
                let row = &self.rows[(digit * BASE + value) * self.count..][..self.count];
                for (o, power) in out.iter_mut().zip(row) {
                    *o = flush(*o * power);
                }
            }
        }
    }
}

/// ρ^k, the table growing as needed.
#[derive(Debug)]
pub struct GrowingPowers(Vec<f64>);

impl GrowingPowers {
    pub fn new(base: f64) -> Self {
        Self(vec![1.0, base])
    }

    pub fn get(&mut self, k: usize) -> f64 {
        while self.0.len() <= k {
            let next = flush(self.0[self.0.len() - 1] * self.0[1]);
            self.0.push(next);
        }
        self.0[k]
    }
}

fn flush(x: f64) -> f64 {
    if x < SMALLEST { 0.0 } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_agree_with_the_library_for_small_and_large_exponents() {
        let albedos = [0.0, 0.05, 0.9, 0.9991, 0.99999, 1.0];
        let powers = AlbedoPowers::new(&albedos);
        let mut out = [0.0; 6];
        for n in [0, 1, 2, 63, 64, 65, 4095, 4096, 100_000, 1_000_000] {
            powers.write(n, 2.0, &mut out);
            for (albedo, power) in albedos.iter().zip(out) {
                let expected = 2.0 * albedo.powi(n as i32);
                assert!((power - expected).abs() <= 1e-9 * expected + 1e-99, "{albedo}^{n}: {power}");
            }
        }
        let mut growing = GrowingPowers::new(0.972);
        assert!((growing.get(20) - 0.972_f64.powi(20)).abs() < 1e-14);
        assert_eq!(growing.get(0), 1.0);
    }
}
