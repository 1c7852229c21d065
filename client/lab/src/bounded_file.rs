//! Reads whole files up to a size.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use anyhow::{Result, bail};

/// All bytes of a file. A pipe or a device, whose size is unknown, is read up to the limit; more bytes are an error.
pub fn read(path: &Path, most_bytes: u64) -> Result<Vec<u8>> {
    let file = File::open(path)?;
    let size = file.metadata()?.len();
    if size > most_bytes {
        bail!("the file has {size} bytes, {most_bytes} are allowed");
    }
    let mut bytes = Vec::with_capacity(size as usize);
    fill(&mut bytes, file, most_bytes)?;
    Ok(bytes)
}

/// Appends all bytes of a source; more than `most_bytes` in total are an error.
pub fn fill(bytes: &mut Vec<u8>, from: impl Read, most_bytes: u64) -> Result<()> {
    from.take(most_bytes + 1).read_to_end(bytes)?;
    if bytes.len() as u64 > most_bytes {
        bail!("the file has more than {most_bytes} bytes, which is the most that is read");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_read_up_to_a_size() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, [7; 10]).unwrap();
        assert_eq!(read(&path, 10).unwrap(), [7; 10]);
        assert_eq!(read(&path, 9).unwrap_err().to_string(), "the file has 10 bytes, 9 are allowed");
        let error = read(Path::new("/dev/zero"), 1000).unwrap_err().to_string();
        assert!(error.contains("more than 1000 bytes"), "{error}");
    }
}
