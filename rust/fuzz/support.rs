//! What the targets share: the input as a file. Checksums are not compared under `cfg(fuzzing)`, so that the
//! fuzzer gets to everything behind them.

use std::path::PathBuf;

/// A file that goes with the value.
pub struct Input {
    pub path: PathBuf,
}

/// The input as a file in memory, one a process.
pub fn file(data: &[u8]) -> Input {
    let folder = if cfg!(target_os = "linux") {
        "/dev/shm".into()
    } else {
        std::env::temp_dir()
    };
    let path = folder.join(format!("vhs-fuzz-{}", std::process::id()));
    std::fs::write(&path, data).expect("a writable folder");
    Input { path }
}

impl Drop for Input {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}
