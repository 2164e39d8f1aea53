//! What goals look like: images of achieved goals by class, and one mean feature vector a class.

pub mod draws;
pub mod prototypes;
pub mod store;

mod file;

pub use self::draws::Balance;
pub use self::prototypes::Prototypes;
pub use self::store::GoalStore;
pub use crate::labels::MAX_CLASSES;
