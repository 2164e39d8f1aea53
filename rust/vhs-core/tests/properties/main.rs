//! Properties of the core, each checked against a naive reference on random operations.

mod support;

mod episodes;
mod errors;
mod frames;
mod goals;
mod persist;
mod prototypes;
mod relabel;
mod returns;
mod threads;
