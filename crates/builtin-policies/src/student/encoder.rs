//! Encoder: maps a picture to 320 features, modulated by the text.

use crate::student::block::{Block, Shape, Workspace, zeros};
use crate::student::columns::{self, Planes, Rows};
use crate::student::convolution::Convolution;
use crate::student::error::WeightsError;
use crate::student::lanes;
use crate::student::norm::{Film, GroupNorm};
use crate::student::picture;
use crate::student::points::{self, POINTS};
use crate::student::product::Matrix;
use crate::student::weights::Tensors;

/// Channels of the first convolution.
const STEM: usize = 32;
const BLOCKS: [Shape; 3] = [
    Shape { inputs: STEM, outputs: 48, stride: 2 },
    Shape { inputs: 48, outputs: 96, stride: 2 },
    Shape { inputs: 96, outputs: FEATURES, stride: 1 },
];
/// Channels of the last block.
const FEATURES: usize = 128;
pub(crate) const WIDTH: usize = 3 * POINTS + FEATURES;

#[derive(Debug)]
pub(crate) struct Encoder {
    stem: Convolution,
    stem_norm: GroupNorm,
    blocks: [Block; 3],
    points: Convolution,
    points_bias: Vec<f32>,
    /// Layer that adds scores from the first block's planes, which have twice the resolution,
    /// to the points' scores.
    fine: Option<Convolution>,
}

/// Modulation of each block by the texts of some queries: a row per query.
#[derive(Debug)]
pub(crate) struct Films([Vec<f32>; 3]);

/// Scratch memory for a picture and its planes, reused by all queries.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    picture: Vec<f32>,
    planes: [Vec<f32>; 2],
    /// Planes of the first block, if [`Encoder::fine`] is present.
    fine: Vec<f32>,
    work: Workspace,
}

impl Encoder {
    /// Reads the tensors with the prefix `camera`. `text` is the width of the text embedding.
    pub(crate) fn read(
        tensors: &mut Tensors<'_>,
        camera: &str,
        text: usize,
    ) -> Result<Self, WeightsError> {
        let part = |part: &str| format!("{camera}.{part}");
        let mut block = |index: usize| {
            let name = part(&format!("block{}", index + 1));
            Block::read(tensors, &name, BLOCKS[index], text)
        };
        Ok(Self {
            blocks: [block(0)?, block(1)?, block(2)?],
            stem: Convolution::read_3x3(tensors, &part("stem.conv"), 3, STEM)?,
            stem_norm: GroupNorm::read(tensors, &part("stem.norm"), STEM)?,
            points: Convolution::read_1x1(tensors, &part("points"), FEATURES, POINTS)?,
            points_bias: tensors.half(&part("points.bias"), &[POINTS])?,
            fine: match tensors.is_fine() {
                true => {
                    let name = part("fine");
                    Some(Convolution::read_1x1(tensors, &name, BLOCKS[0].outputs, POINTS)?)
                }
                false => None,
            },
        })
    }

    /// Returns the modulation of this encoder's blocks by texts (a row per query).
    pub(crate) fn films(&self, texts: &[f32]) -> Films {
        let films = |block: &Block| block.film.apply(texts);
        Films(self.blocks.each_ref().map(films))
    }

    /// Fills `encoded` for the picture `rgb` of query number `query`: expected columns,
    /// expected rows and peaks of the points, then means of the features.
    pub(crate) fn encode(
        &self,
        rgb: &[u8],
        (films, query): (&Films, usize),
        scratch: &mut Scratch,
        encoded: &mut [f32],
    ) {
        let Scratch { picture, planes: [planes, next], fine, work } = scratch;
        picture::planes(rgb, picture);
        let picture = Planes { values: picture, side: picture::SIDE };
        let mut side = picture::SIDE / 2;
        zeros(planes, STEM * side * side);
        columns::each_part(picture, 2, &mut work.buffers, |part| {
            self.stem.add(part.windows(), planes);
        });
        self.stem_norm.relu(planes);
        let blocks = self.blocks.iter().zip(films.0.iter().zip(BLOCKS));
        for (index, (block, (films, shape))) in blocks.enumerate() {
            let input = Planes { values: planes, side };
            let film = Film(&films[query * 2 * shape.outputs..][..2 * shape.outputs]);
            block.apply(input, film, work, next);
            std::mem::swap(planes, next);
            side /= shape.stride;
            if index == 0 && self.fine.is_some() {
                fine.clone_from(planes);
            }
        }
        let (located, means) = encoded.split_at_mut(3 * POINTS);
        self.locate([planes, fine], next, located);
        for (plane, mean) in planes.chunks_exact(side * side).zip(means) {
            *mean = lanes::mean(plane);
        }
    }

    /// Locates the points in the last features and, if `self.fine` is present, in the first
    /// block's planes too; `scores` is scratch memory.
    fn locate(&self, [features, first]: [&[f32]; 2], scores: &mut Vec<f32>, located: &mut [f32]) {
        let places = features.len() / FEATURES;
        scores.clear();
        for bias in &self.points_bias {
            scores.extend(std::iter::repeat_n(bias, places));
        }
        let all_rows = |planes, channels, places| Rows {
            columns: Matrix::new(planes, channels, places),
            input: 0,
            place: 0,
        };
        self.points.add(all_rows(features, FEATURES, places), scores);
        let Some(fine) = &self.fine else {
            return points::locate::<{ points::SIDE }>(scores, located);
        };
        let mut enlarged = points::enlarged(scores);
        let channels = BLOCKS[0].outputs;
        fine.add(all_rows(first, channels, first.len() / channels), &mut enlarged);
        points::locate::<{ 2 * points::SIDE }>(&enlarged, located);
    }
}
