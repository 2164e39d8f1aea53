//! Hindsight storage for reinforcement learning from images.
