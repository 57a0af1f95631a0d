"""The student's network, which computes eight actions from two pictures, the robot's state and an
instruction.

The network keeps no state between queries. Its parameters have the names of the tensors in a
weights file."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from training.text import BUCKETS

CHUNK = 8
"""Number of actions in the answer to a query."""
ARM = 6
"""Numbers of an action for the arm; a seventh number is for the gripper."""
STATE = 14
"""Numbers of the robot's state: the hand's position, m, and rotation matrix, world frame (3 and 9);
positions of the fingers, m (2)."""
PICTURE = 128
"""Height and width of a picture, pixels."""

WORD_WIDTH = 48
TEXT_WIDTH = 128
POINTS = 64
"""Number of learned points in each camera's picture."""
GRID = 32
"""Height and width of the map in which points are located, twice those of ``block3``'s output."""
HEAD = 512
"""Width of the two layers before the actions."""
GROUPS = 8
"""Number of groups of channels in each normalisation."""


class Actions(NamedTuple):
    """The network's output for n queries, before clipping to the robot's range."""

    arm: Tensor
    """[n, 8, 6]: the arm's part of each action."""
    gripper: Tensor
    """[n, 8]: a positive value closes the gripper."""


class Stem(nn.Module):
    """Convolution of 128 × 128 pixels to 32 channels of 64 × 64."""

    def __init__(self) -> None:
        super().__init__()
        self.conv = nn.Conv2d(3, 32, 3, stride=2, padding=1, bias=False)
        self.norm = nn.GroupNorm(GROUPS, 32)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(self.norm(self.conv(x)))


class Block(nn.Module):
    """A residual block, scaled and shifted by the instruction."""

    def __init__(self, channels: int, out: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, out, 3, stride=stride, padding=1, bias=False)
        self.norm1 = nn.GroupNorm(GROUPS, out)
        self.film = nn.Linear(TEXT_WIDTH, 2 * out)
        self.conv2 = nn.Conv2d(out, out, 3, padding=1, bias=False)
        self.norm2 = nn.GroupNorm(GROUPS, out)
        self.skip = nn.Conv2d(channels, out, 1, stride=stride, bias=False)

    def forward(self, x: Tensor, text: Tensor) -> Tensor:
        gamma, beta = self.film(text)[:, :, None, None].chunk(2, dim=1)
        h = self.norm1(self.conv1(x))
        h = functional.relu((1 + gamma) * h + beta)
        h = self.norm2(self.conv2(h))
        return functional.relu(h + self.skip(x))


class Encoder(nn.Module):
    """Encoder of one camera: converts pictures [n, 3, 128, 128] to features [n, 320].

    The 320 features are the columns, rows and peaks of 64 learned points, and the means of 128
    channels."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = Stem()
        self.block1 = Block(32, 48, stride=2)
        self.block2 = Block(48, 96, stride=2)
        self.block3 = Block(96, 128, stride=1)
        self.points = nn.Conv2d(128, POINTS, 1)
        # Refines the points' positions with features of twice the resolution.
        self.fine = nn.Conv2d(48, POINTS, 1, bias=False)

    def forward(self, picture: Tensor, text: Tensor) -> Tensor:
        fine = self.block1(self.stem(picture), text)
        x = self.block3(self.block2(fine, text), text)
        # Exponentials and coordinates use single precision, whatever the other layers use.
        coarse = functional.interpolate(self.points(x).float(), scale_factor=2, mode="nearest")
        scores = (coarse + self.fine(fine).float()).flatten(2)
        probability = scores.softmax(dim=2).unflatten(2, (GRID, GRID))
        positions = torch.linspace(-1.0, 1.0, GRID, device=x.device)
        columns = (probability.sum(dim=2) * positions).sum(dim=2)
        rows = (probability.sum(dim=3) * positions).sum(dim=2)
        return torch.cat([columns, rows, scores.amax(dim=2), x.float().mean(dim=(2, 3))], dim=1)


class Network(nn.Module):
    state_mean: Tensor
    state_std: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.words = nn.Embedding(BUCKETS, WORD_WIDTH)
        self.text1 = nn.Linear(WORD_WIDTH, TEXT_WIDTH)
        self.text2 = nn.Linear(TEXT_WIDTH, TEXT_WIDTH)
        self.agentview = Encoder()
        self.wrist = Encoder()
        self.state1 = nn.Linear(STATE, 64)
        encoded = 3 * POINTS + 128
        self.head1 = nn.Linear(2 * encoded + 64 + TEXT_WIDTH, HEAD)
        self.head2 = nn.Linear(HEAD, HEAD)
        self.arm = nn.Linear(HEAD, CHUNK * ARM)
        self.gripper = nn.Linear(HEAD, CHUNK)
        self.register_buffer("state_mean", torch.zeros(STATE))
        self.register_buffer("state_std", torch.ones(STATE))
        # Initially zero, so that words that never occur in training have no effect.
        nn.init.zeros_(self.words.weight)

    def forward(
        self, agentview: Tensor, wrist: Tensor, state: Tensor, rows: Tensor, present: Tensor
    ) -> Actions:
        """Returns actions for n queries. Pictures are [n, 3, 128, 128], from -1 to 1; `state` is
        [n, 14], unscaled: metres, and elements of a rotation matrix; `rows`, int64 [n, w], has the
        instruction's features, and `present`, [n, w], is 1 where there is one, else 0."""
        text = (self.words(rows) * present[:, :, None]).sum(dim=1)
        text = functional.relu(self.text2(functional.relu(self.text1(text))))
        robot = functional.relu(self.state1((state - self.state_mean) / self.state_std))
        x = torch.cat(
            [self.agentview(agentview, text), self.wrist(wrist, text), robot, text], dim=1
        )
        x = functional.relu(self.head2(functional.relu(self.head1(x))))
        return Actions(self.arm(x).float().unflatten(1, (CHUNK, ARM)), self.gripper(x).float())


def parameters(network: nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def to_actions(output: Actions) -> Tensor:
    """Converts outputs to the robot's actions, [n, 8, 7]: arm -1 to 1, gripper 1 or -1."""
    gripper = torch.where(output.gripper > 0, 1.0, -1.0)
    return torch.cat([output.arm.clamp(-1.0, 1.0), gripper[:, :, None]], dim=2)
