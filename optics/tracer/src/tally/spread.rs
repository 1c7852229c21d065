//! Observes how the batches of a chunk spread about their mean, at some of the pixels: what exact levels leave of it.

/// Sums over batches, by column of a pixel: of a = F − C_dark at the observed pixels, of b = C_light − C_dark, C being the
/// levels by the controls, and of their squares and products. Without controls a is F, and b is 0.
#[derive(Debug)]
pub struct Spread {
    /// The observed pixels, see [`observed`].
    pixels: Vec<usize>,
    /// By observed pixel.
    sums: Vec<PixelSums>,
    b: Vec<f64>,
    bb: Vec<f64>,
    batches: u64,
}

#[derive(Debug, Clone)]
struct PixelSums {
    /// F up to the last batch.
    value: Vec<f32>,
    a: Vec<f64>,
    aa: Vec<f64>,
    ab: Vec<f64>,
}

/// The levels of a chunk by column: the dark one, and the light one's difference from it.
pub struct WalkLevels {
    pub dark: Vec<f32>,
    pub contrast: Vec<f32>,
}

impl WalkLevels {
    /// The light side's share of a value, see [`optics_model::sums::Sums::into_records`].
    #[inline(always)]
    fn share(&self, column: usize, value: f32) -> f64 {
        match f64::from(self.contrast[column]) {
            0.0 => 0.5,
            contrast => f64::from(value - self.dark[column]) / contrast,
        }
    }
}

impl Spread {
    pub fn new(pixels: usize, columns: usize) -> Self {
        let pixels = observed(pixels);
        let zeros = || vec![0.0; columns];
        let sums = PixelSums { value: vec![0.0; columns], a: zeros(), aa: zeros(), ab: zeros() };
        Self { sums: vec![sums; pixels.len()], pixels, b: zeros(), bb: zeros(), batches: 0 }
    }

    /// The observed pixel of a number; None beyond the last.
    pub fn pixel(&self, number: usize) -> Option<usize> {
        self.pixels.get(number).copied()
    }

    pub fn batches(&self) -> u64 {
        self.batches
    }

    /// Adds a batch at an observed pixel, whose values with this batch are given, and the batch's own levels.
    #[inline(always)]
    pub fn add(&mut self, number: usize, values: &[f32], dark: &[f64], contrast: &[f64]) {
        let PixelSums { value, a, aa, ab } = &mut self.sums[number];
        let len = values.len();
        let (value, dark, contrast) = (&mut value[..len], &dark[..len], &contrast[..len]);
        let [a, aa, ab] = [a, aa, ab].map(|sums| &mut sums[..len]);
        for i in 0..len {
            let over_dark = f64::from(values[i] - value[i]) - dark[i];
            a[i] += over_dark;
            aa[i] += over_dark * over_dark;
            ab[i] += over_dark * contrast[i];
        }
        value.copy_from_slice(values);
    }

    /// Ends a batch that was added at all observed pixels.
    #[inline(always)]
    pub fn end_batch(&mut self, contrast: &[f64]) {
        for ((b, bb), contrast) in self.b.iter_mut().zip(&mut self.bb).zip(contrast) {
            *b += contrast;
            *bb += contrast * contrast;
        }
        self.batches += 1;
    }

    /// Adds for every pixel and column the sum of the squares of the deviations of a − s b from its mean, s being the share
    /// of all batches. Between observed pixels it is interpolated.
    #[inline(always)]
    pub fn add_deviations(&self, levels: &WalkLevels, deviations: &mut [f64]) {
        let columns = self.b.len();
        let each = |sums: &PixelSums| -> Vec<f64> {
            let deviation = |column| self.deviation(sums, column, levels.share(column, sums.value[column]));
            (0..columns).map(deviation).collect()
        };
        let observed: Vec<Vec<f64>> = self.sums.iter().map(each).collect();
        let mut at = 0;
        for (pixel, deviations) in deviations.chunks_exact_mut(columns).enumerate() {
            while at + 1 < self.pixels.len() && self.pixels[at + 1] <= pixel {
                at += 1;
            }
            let next = (at + 1).min(self.pixels.len() - 1);
            let between = (self.pixels[next] - self.pixels[at]).max(1) as f64;
            let share = (pixel - self.pixels[at]) as f64 / between;
            for (sum, (a, b)) in deviations.iter_mut().zip(observed[at].iter().zip(&observed[next])) {
                *sum += a + share * (b - a);
            }
        }
    }

    #[inline(always)]
    fn deviation(&self, sums: &PixelSums, column: usize, share: f64) -> f64 {
        let (a, b, batches) = (sums.a[column], self.b[column], self.batches as f64);
        let variance = sums.aa[column] - a * a / batches;
        let covariance = sums.ab[column] - a * b / batches;
        let level_variance = self.bb[column] - b * b / batches;
        (variance - share * (covariance + covariance - share * level_variance)).max(0.0)
    }
}

/// Pixels at which the spread of batches is observed, the first and the last among them. In between, the spread is
/// interpolated: it is smooth except near the edge.
fn observed(pixels: usize) -> Vec<usize> {
    let mut observed = Vec::new();
    let mut pixel = 0;
    while pixel + 1 < pixels {
        observed.push(pixel);
        let from_edge = (2 * pixel + 1).abs_diff(pixels) / 2;
        let step = match from_edge {
            0..4 => 1,
            4..12 => 2,
            12..36 => 6,
            _ => 24,
        };
        // Not over the fine ones near the edge.
        let next = pixel + step;
        let fine = (pixels / 2).saturating_sub(4);
        pixel = if pixel < fine && next > fine { fine } else { next };
    }
    observed.push(pixels - 1);
    observed
}
