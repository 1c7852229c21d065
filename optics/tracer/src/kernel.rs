//! Runs walks one after the other, or in vectors with the instructions of this machine.

use std::fmt;
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

use fearless_simd::{Level, dispatch};
use optics_model::sums::Sums;

use super::exits::{Chunk, Exits};
use super::light::Light;
use super::stack::Stack;
use super::tally::Tally;
use super::vertex::Vertex;
use super::wavefront::Places;
use super::{Stopped, walk, wavefront};

/// A way of running walks. All kernels give the same bits.
#[derive(Debug, Clone, Copy)]
pub struct Kernel(KernelKind);

static CHOSEN: OnceLock<Kernel> = OnceLock::new();

#[derive(Debug, Clone, Copy)]
enum KernelKind {
    Scalar,
    Vector(Level),
}

impl Kernel {
    /// One walk after the other: slow, and plain enough to be checked by eye.
    pub const SCALAR: Self = Self(KernelKind::Scalar);

    /// The kernel of this process: the one set with [`Self::choose`], or [`Self::fastest`].
    pub fn chosen() -> Self {
        CHOSEN.get().copied().unwrap_or_else(Self::fastest)
    }

    /// Makes this process run walks with this kernel from now on. Only the first choice takes effect.
    pub fn choose(self) {
        let _ = CHOSEN.set(self);
    }

    /// The kernel of a name, if this machine can run it.
    pub fn named(name: &str) -> Option<Self> {
        Self::all().into_iter().find(|kernel| kernel.name() == name)
    }

    /// The kernel that is usually the fastest: the vector kernel with the best instructions of this machine, or the
    /// scalar one where vector operations have to be pieced together (SSE2) or emulated.
    pub fn fastest() -> Self {
        match Level::new() {
            #[cfg(target_arch = "x86_64")]
            Level::Sse2(_) => Self::SCALAR,
            level if level.is_fallback() => Self::SCALAR,
            level => Self(KernelKind::Vector(level)),
        }
    }

    /// All kernels that this machine can run: vectors from wide to narrow, then the scalar one.
    pub fn all() -> Vec<Self> {
        let level = Level::new();
        let mut levels = vec![level];
        #[cfg(target_arch = "x86_64")]
        levels.extend(
            [
                level.as_avx2().map(Level::Avx2),
                level.as_sse4_2().map(Level::Sse4_2),
                level.as_sse2().map(Level::Sse2),
            ]
            .into_iter()
            .flatten(),
        );
        levels.push(Level::baseline());
        let mut kernels: Vec<_> = levels.into_iter().map(|level| Self(KernelKind::Vector(level))).collect();
        kernels.dedup_by_key(|kernel| kernel.name());
        kernels.push(Self::SCALAR);
        kernels
    }

    pub fn name(self) -> &'static str {
        match self.0 {
            KernelKind::Scalar => "scalar",
            #[cfg(target_arch = "x86_64")]
            KernelKind::Vector(Level::Avx512(_)) => "avx512",
            #[cfg(target_arch = "x86_64")]
            KernelKind::Vector(Level::Avx2(_)) => "avx2",
            #[cfg(target_arch = "x86_64")]
            KernelKind::Vector(Level::Sse4_2(_)) => "sse4.2",
            #[cfg(target_arch = "x86_64")]
            KernelKind::Vector(Level::Sse2(_)) => "sse2",
            #[cfg(target_arch = "aarch64")]
            KernelKind::Vector(Level::Neon(_)) => "neon",
            KernelKind::Vector(_) => "portable",
        }
    }

    pub(super) fn run_chunk(
        self,
        stack: &Stack,
        light: &Light,
        chunk: Chunk,
        stop: &AtomicBool,
        places: &mut Places,
        exits: &mut Exits,
    ) -> Result<(), Stopped> {
        exits.reset(chunk.walks);
        match self.0 {
            KernelKind::Scalar => walk::run_chunk(stack, light, chunk, stop, exits),
            KernelKind::Vector(level) => {
                wavefront::run_chunk(level, stack, light, chunk, stop, places, exits)
            }
        }
    }

    /// The light in a stack.
    pub(super) fn light(self, stack: &Stack, derivatives: bool) -> Light {
        dispatch!(self.level(), _simd => Light::new(stack, derivatives))
    }

    /// Adds the vertices of one batch to the tally. The loops are plain; here the compiler may use this machine's vectors.
    pub(super) fn score(self, tally: &mut Tally<'_>, vertices: &[Vertex]) {
        dispatch!(self.level(), simd => tally.add_batch(simd, vertices));
    }

    /// Adds the results of the tally's batches to `sums`.
    pub(super) fn end(self, tally: &mut Tally<'_>, sums: &mut Sums) {
        dispatch!(self.level(), simd => tally.end(simd, sums));
    }

    fn level(self) -> Level {
        match self.0 {
            KernelKind::Scalar => Level::baseline(),
            KernelKind::Vector(level) => level,
        }
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests;
