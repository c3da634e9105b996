//! What vehicles sense of the world around them.
//!
//! | file | what |
//! |---|---|
//! | [`cast`] | rays: distances to a scene, pixel by pixel or beam by beam |

pub mod cast;
