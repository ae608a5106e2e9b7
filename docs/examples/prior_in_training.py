"""Train a network whose decoder is the hand and whose loss knows what hands can do.

A small network sees the 21 points of a hand in a picture, relative to the wrist, and answers with joint angles and the
hand's rotation. The loss compares the keypoints of that hand with the true ones and adds the prior's energy, so that
postures which no hand takes cost something. Runs in seconds; `torchhand learn_pose` is the same idea in earnest.
"""

import torch

from torchhand import Hand, load_hand_model


def main(steps: int = 60, hands: int = 256, seed: int = 0) -> list[float]:
    generator = torch.Generator().manual_seed(seed)
    torch.manual_seed(seed)
    model = load_hand_model()
    hand, prior = Hand(side="right"), model.prior()

    poses, shapes = prior.sample(hands, generator)  # (hands, 36) and (hands, 52): people and what their hands do
    poses[:, :3] = 0.0
    poses[:, 3:6] = 0.5 * torch.randn(hands, 3, generator=generator)  # turned a little
    with torch.no_grad():
        true = hand(poses, shapes).keypoints
    true = true - true[:, :1]
    seen = true[..., :2] / 0.19  # an orthographic picture, in hand lengths

    network = torch.nn.Sequential(torch.nn.Linear(42, 128), torch.nn.ELU(), torch.nn.Linear(128, 33))
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    losses = []
    for _ in range(steps):
        answer = network(seen.flatten(1))
        pose = torch.cat((torch.zeros(hands, 3), answer), -1)  # 3 of the rotation, 30 joint angles
        keypoints = hand(pose, shapes).keypoints
        keypoints = keypoints - keypoints[:, :1]
        error_mm = 1e3 * (keypoints - true).norm(dim=-1).mean()
        loss = error_mm + 0.01 * prior.energy(pose, shapes).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(error_mm.detach()))
    print(f"mean error of the keypoints: {losses[0]:.1f} mm before, {losses[-1]:.1f} mm after {steps} steps")
    return losses


if __name__ == "__main__":
    main()
