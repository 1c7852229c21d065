//! Arguments of `profile`.

use std::path::PathBuf;

use clap::Args;

#[derive(Debug, Args)]
pub struct ProfileArgs {
    /// Dictionary to ask [default: the only one, or paper].
    #[arg(long, value_name = "NAME")]
    pub dictionary: Option<String>,
    /// Extinction coefficient, per mm.
    #[arg(long, value_name = "PER_MM", allow_negative_numbers = true)]
    pub sigma_t: f64,
    /// Single-scattering albedo.
    #[arg(long, allow_negative_numbers = true)]
    pub albedo: f64,
    /// Anisotropy.
    #[arg(long, allow_negative_numbers = true)]
    pub g: f64,
    /// Thickness in mm: near one of the dictionary's, or between two.
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    pub thickness: f64,
    /// Refractive index of the sample [default: the dictionary's first].
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub sample_ior: Option<f64>,
    /// Channels of the camera, as in R or R,G,B [default: the dictionary's first].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub channel: Vec<String>,
    /// Draw the profiles and their gradients: FILE.svg or FILE.png.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
}
