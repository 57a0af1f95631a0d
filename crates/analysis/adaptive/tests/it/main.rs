//! Tests of both searches.

mod radii;
mod subsets;
