//! Properties of the core, each checked against a naive reference on random operations.

mod support;

mod draws;
mod egomotion;
mod episodes;
mod errors;
mod fields;

mod goals;
mod kept;
mod persist;
mod priorities;
mod prototypes;
mod relabel;
mod returns;
mod stacking;
mod threads;
