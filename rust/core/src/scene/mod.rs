//! What laser light shows that does not lie on the face.

pub(crate) mod hidden;
mod in_front;
