//! The measured media of slabs in one channel, ready to be predicted.

use anyhow::{Context, Result, bail};
use farm_lab::media_file::MediaFile;
use optics_layers::{PrintedSlab, Uncertain};

use super::slabs::NamedSlab;

/// The materials of slabs, each once.
#[derive(Debug)]
pub(super) struct UsedMaterials<'a> {
    file: &'a MediaFile,
    names: Vec<&'a str>,
    slabs: Vec<PrintedSlab>,
}

/// The media of one channel.
#[derive(Debug)]
pub(super) struct ChannelMedia {
    pub media: Vec<Uncertain>,
    pub sample_ior: f64,
    /// Materials that the measurement does not determine in the channel.
    pub unresolved: Vec<String>,
}

impl<'a> UsedMaterials<'a> {
    pub(super) fn new(file: &'a MediaFile, slabs: &'a [NamedSlab]) -> Result<Self> {
        let mut names: Vec<&str> = Vec::new();
        let mut index = |name: &'a str| -> Result<usize> {
            if let Some(known) = names.iter().position(|n| *n == name) {
                return Ok(known);
            }
            file.material(name)?;
            names.push(name);
            Ok(names.len() - 1)
        };
        let mut slab = |slab: &'a NamedSlab| -> Result<PrintedSlab> {
            let shares = slab.shares.iter().map(|(name, share)| Ok((index(name)?, *share)));
            Ok(PrintedSlab { shares: shares.collect::<Result<_>>()?, thickness_mm: slab.thickness_mm })
        };
        let slabs = slabs.iter().map(&mut slab).collect::<Result<_>>()?;
        Ok(Self { file, names, slabs })
    }

    pub(super) fn slabs(&self) -> &[PrintedSlab] {
        &self.slabs
    }

    /// The channels that all materials have, in the order of the first one.
    pub(super) fn channels(&self) -> Result<Vec<&'a str>> {
        let (first, others) = self.names.split_first().context("a print has at least one slab")?;
        let mut channels: Vec<&str> =
            self.file.material(first)?.channels.iter().map(|c| c.channel.as_str()).collect();
        for name in others {
            let material = self.file.material(name)?;
            channels.retain(|channel| material.channel(channel).is_some());
        }
        if channels.is_empty() {
            bail!("no channel has a medium of {}", self.names.join(" and "));
        }
        Ok(channels)
    }

    /// # Panics
    /// If a material does not have the channel.
    pub(super) fn of(&self, channel: &str) -> Result<ChannelMedia> {
        let (mut media, mut unresolved, mut iors) = (Vec::new(), Vec::new(), Vec::new());
        for name in &self.names {
            let found = self.file.material(name)?.channel(channel).expect("a channel of all materials");
            media.push(Uncertain {
                medium: found.medium()?,
                second_lobe: found.second_lobe()?,
                covariance: found.covariance,
            });
            if !found.resolved {
                unresolved.push((*name).to_owned());
            }
            iors.push(found.sample_ior);
        }
        let sample_ior = iors.iter().sum::<f64>() / iors.len() as f64;
        Ok(ChannelMedia { media, sample_ior, unresolved })
    }
}
