//! The goal store from plain Rust: fill it, draw a balanced batch, save it and go on.
//!
//! Run with `cargo run --release -p vhs-core --example goal_store`.

use std::io::{self, Write};

use vhs_core::goals::{Balance, GoalStore};

/// Goal classes of the navigation tasks.
const CLASSES: usize = 5;
/// Two stacked 84x84 RGB frames.
const SHAPE: [usize; 4] = [2, 84, 84, 3];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut out = io::stdout();
    let mut store = GoalStore::new(CLASSES, &SHAPE, 2000, 0)?;

    // Successes come unevenly: class c is reached c + 1 times in 15.
    for episode in 0_u8..150 {
        let class = [0, 1, 1, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 4][usize::from(episode % 15)];
        store.push(&vec![episode; SHAPE.iter().product()], class)?;
    }
    let counts: Vec<usize> = store.counts().collect();
    writeln!(out, "stored {} images, by class {counts:?}", store.len())?;

    // A contrastive batch wants every class equally often.
    let (images, labels) = store.sample(64, Balance::Classes)?;
    let drawn: Vec<usize> = (0_i64..5)
        .map(|class| labels.iter().filter(|&&label| label == class).count())
        .collect();
    writeln!(
        out,
        "drew {} MB, by class {drawn:?}",
        images.len() / 1_000_000
    )?;

    // A saved store goes on with the same batches: its generator is part of the file.
    let path = std::env::temp_dir().join("example.goals");
    store.save(&path)?;
    let mut loaded = GoalStore::load(&path)?;
    let same = loaded.sample(64, Balance::Classes)? == store.sample(64, Balance::Classes)?;
    writeln!(out, "the loaded store draws the same batch: {same}")?;
    std::fs::remove_file(path)?;
    Ok(())
}
