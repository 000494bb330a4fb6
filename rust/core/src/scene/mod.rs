//! What laser light shows of the face's surroundings: where it lies on the face's plane, and what does not.

pub(crate) mod cut;
#[cfg(test)]
pub(crate) mod drawn;
pub(crate) mod hidden;
mod in_front;
pub(crate) mod lit;
pub(crate) mod step;
