//! Tests of the searches for thresholds and for minimal subsets.

mod radii;
mod subsets;
