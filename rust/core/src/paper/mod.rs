//! The seed paper's system (Sensors 2019, 19, 3921), for comparison: its single map of edges and stripes ([`edge_map`]), the Hough
//! transform with clusters ([`hough`]), the face among the lines ([`outline`]), and sides from the eight key points ([`key_points`],
//! eqs. 5 to 11). `--edges hough` and `--method keypoints` choose it; without a network the map is the picture's gradient.

pub(crate) mod edge_map;
pub(crate) mod hough;
pub(crate) mod key_points;
pub(crate) mod outline;
