//! The rules of hindsight: which rows get another goal, which goal, and what they are rewarded. No data lies here.

pub mod reward;
pub mod rule;
pub mod strategy;
