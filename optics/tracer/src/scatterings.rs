//! Interpolates powers of the albedo by the number of scatterings between a few nodes.
//!
//! A walk of n scatterings contributes α^n for the albedo α. Rather than adding this for every albedo, the tally adds to
//! nodes of n, and evaluates them for all albedos at the end of a batch. Up to 32 each number is a node; above there are
//! 8 nodes per octave, and n is distributed over the 8 nodes around it with Lagrange weights: α^n is approximated by a
//! polynomial of degree 7 there. Its error is below 4e-7 of the greatest power where (nα^n)^8 has its maximum, and far
//! below that elsewhere.

use fearless_simd::{Simd, SimdBase, f32x16};

/// Nodes that a number is distributed over.
pub const WINDOW: usize = 8;
/// Numbers below this are nodes themselves.
const EXACT: u32 = 32;
/// Nodes per octave, as a power of 2.
const OCTAVE_BITS: u32 = 3;

/// Powers below this are taken as 0.
const SMALLEST: f64 = 1e-100;
/// Powers up to this are negligible compared with those of fewer scatterings.
const NOTHING: f64 = 1e-15;

/// The node at or below n.
fn node_below(n: u32) -> usize {
    if n < EXACT {
        return n as usize;
    }
    let octave = n.ilog2() - EXACT.ilog2();
    let step_bits = octave + EXACT.ilog2() - OCTAVE_BITS;
    let beyond = (n - (EXACT << octave)) >> step_bits;
    ((EXACT + (octave << OCTAVE_BITS)) + beyond) as usize
}

/// The number of scatterings that a node stands for.
fn node(index: usize) -> u64 {
    if index < EXACT as usize {
        return index as u64;
    }
    let beyond = index - EXACT as usize;
    let (octave, step) = (beyond >> OCTAVE_BITS, (beyond & ((1 << OCTAVE_BITS) - 1)) as u64);
    (u64::from(EXACT) << octave) + (step << (octave as u32 + EXACT.ilog2() - OCTAVE_BITS))
}

/// Nodes that are needed for numbers up to `most`.
pub fn count(most: u32) -> usize {
    node_below(most.max(EXACT)) + WINDOW / 2 + 1
}

/// First of the nodes that n is distributed over, and their shares.
pub fn shares(n: u32) -> (usize, [f64; WINDOW]) {
    let below = node_below(n);
    let mut shares = [0.0; WINDOW];
    if n < EXACT {
        let first = below.min(EXACT as usize - WINDOW);
        shares[below - first] = 1.0;
        return (first, shares);
    }
    let first = below + 1 - WINDOW / 2;
    let nodes: [f64; WINDOW] = std::array::from_fn(|i| node(first + i) as f64);
    for (i, share) in shares.iter_mut().enumerate() {
        let mut product = 1.0;
        for (k, other) in nodes.iter().enumerate() {
            if k != i {
                product *= (f64::from(n) - other) / (nodes[i] - other);
            }
        }
        *share = product;
    }
    (first, shares)
}

/// Albedos whose powers lie side by side.
const LANES: usize = 16;
/// Sums that are added up side by side, so that one addition need not wait for the last.
const SUMS: usize = 4;

/// α^n and n α^(n−1) for nodes and albedos.
#[derive(Debug)]
pub struct NodePowers {
    blocks: Vec<PowerBlock>,
    /// Number that each node stands for.
    nodes: Vec<f64>,
}

/// Powers of some albedos, for every node at which they count.
#[derive(Debug)]
struct PowerBlock {
    powers: Vec<[f32; LANES]>,
    derivatives: Vec<[f32; LANES]>,
}

impl PowerBlock {
    fn new(albedos: &[f64], nodes: &[u64]) -> Self {
        let (mut powers, mut derivatives) = (Vec::new(), Vec::new());
        let mut before = [1.0; LANES];
        let mut at = 0;
        for n in nodes {
            let mut row = [0.0; LANES];
            let mut derivative = [0.0; LANES];
            for (lane, albedo) in albedos.iter().enumerate() {
                // α^(n − 1), from the node before.
                let less = before[lane] * power(*albedo, n.saturating_sub(at + 1));
                before[lane] = if *n > at { flush(less * albedo) } else { before[lane] };
                row[lane] = single(before[lane]);
                derivative[lane] = if *n > at { single(*n as f64 * less) } else { 0.0 };
            }
            at = *n;
            if before[..albedos.len()].iter().all(|power| *power < NOTHING) {
                break;
            }
            powers.push(row);
            derivatives.push(derivative);
        }
        Self { powers, derivatives }
    }
}

impl NodePowers {
    /// For numbers of scatterings up to `most`.
    pub fn new(albedos: &[f64], most: u32) -> Self {
        let nodes: Vec<u64> = (0..count(most)).map(node).collect();
        let blocks = albedos.chunks(LANES).map(|albedos| PowerBlock::new(albedos, &nodes)).collect();
        Self { blocks, nodes: nodes.iter().map(|n| *n as f64).collect() }
    }

    /// Σ α^n over the contents of nodes, for every albedo.
    #[expect(clippy::inline_always, reason = "must be compiled for the caller's instruction set")]
    #[inline(always)]
    pub fn sum<S: Simd>(&self, simd: S, held: &[f32], out: &mut [f32]) {
        for (block, out) in self.blocks.iter().zip(out.chunks_mut(LANES)) {
            weigh(simd, &block.powers, held, out);
        }
    }

    /// Σ n α^(n−1).
    #[expect(clippy::inline_always, reason = "must be compiled for the caller's instruction set")]
    #[inline(always)]
    pub fn sum_derivatives<S: Simd>(&self, simd: S, held: &[f32], out: &mut [f32]) {
        for (block, out) in self.blocks.iter().zip(out.chunks_mut(LANES)) {
            weigh(simd, &block.derivatives, held, out);
        }
    }

    /// Numbers that nodes stand for.
    pub fn numbers(&self) -> &[f64] {
        &self.nodes
    }
}

#[expect(clippy::inline_always, reason = "must be compiled for the caller's instruction set")]
#[inline(always)]
fn weigh<S: Simd>(simd: S, rows: &[[f32; LANES]], held: &[f32], out: &mut [f32]) {
    let zero = f32x16::splat(simd, 0.0);
    let [mut a, mut b, mut c, mut d] = [zero; SUMS];
    let len = rows.len().min(held.len());
    let row = |row: &[f32; LANES]| f32x16::from_slice(simd, row);
    let (rows, held) = (rows[..len].chunks_exact(SUMS), held[..len].chunks_exact(SUMS));
    let rest = rows.remainder().iter().zip(held.remainder());
    for (rows, held) in rows.zip(held) {
        a += row(&rows[0]) * held[0];
        b += row(&rows[1]) * held[1];
        c += row(&rows[2]) * held[2];
        d += row(&rows[3]) * held[3];
    }
    for (last, held) in rest {
        a += row(last) * *held;
    }
    let sums = ((a + b) + (c + d)).to_array();
    out.copy_from_slice(&sums[..out.len()]);
}

/// x^n by multiplication only, so that it is the same on every machine.
fn power(x: f64, mut n: u64) -> f64 {
    let (mut result, mut square) = (1.0, x);
    while n > 0 {
        if n & 1 == 1 {
            result = flush(result * square);
        }
        square = flush(square * square);
        n >>= 1;
    }
    result
}

/// Converts to single precision; numbers so small that their products would be slow become 0.
pub fn single(x: f64) -> f32 {
    if x.abs() < 1e-18 { 0.0 } else { x as f32 }
}

fn flush(x: f64) -> f64 {
    if x < SMALLEST { 0.0 } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lookup of a node is the inverse of its number.
    #[test]
    fn node_lookup_inverts_node_numbers() {
        for index in 0..150 {
            let n = node(index) as u32;
            assert_eq!(node_below(n), index);
            assert!(index == 0 || node_below(n - 1) == index - 1);
        }
    }

    /// Shares add up to 1, and the error of interpolated powers is below 4e-7 for every α.
    #[test]
    fn power_sums_are_preserved() {
        let mut worst = 0.0_f64;
        for n in (0..3000).chain((3000..2_000_000).step_by(997)) {
            let (first, shares) = shares(n);
            assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12, "α = 1 is exact");
            for x in [0.01, 0.1, 0.5, 1.0, 2.0, 4.0, 8.0, 12.0, 20.0] {
                let albedo = libm::exp(-x / f64::from(n.max(1)));
                let found: f64 =
                    shares.iter().zip(first..).map(|(s, i)| s * libm::pow(albedo, node(i) as f64)).sum();
                worst = worst.max((found - albedo.powi(n as i32)).abs());
            }
        }
        assert!(worst < 4e-7, "{worst:e}");
    }

    #[test]
    fn powers_agree_with_the_library() {
        for n in [0, 1, 2, 63, 64, 4097, 1_000_000] {
            for albedo in [0.0, 0.05, 0.9, 0.9991, 0.99999, 1.0_f64] {
                let expected = albedo.powi(n as i32);
                assert!((power(albedo, n) - expected).abs() <= 1e-9 * expected + 1e-99, "{albedo}^{n}");
            }
        }
    }
}
