"""Change of the light between two images, which is no deformation of the gel."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

#: Unit of changes of colors, gray values.
COLOUR_UNIT = 50.0
_BANDWIDTH, _NARROW = 7.5, 2.0  # of the colors of pixels that are not deformed, gray values
_PIXELS = 3000  # about which are compared
_SATURATED = 254
_MAX_ITERATIONS = 30
_TOLERANCE = 3e-4
_OFF, _ON = 1e-6, 0.3
# Prior deviations of the factor, of its change to the right, to the lower edge and with the squared
# distance from the center, and of light that is added, gray values; of several changes of the
# light, from the simplest.
_MODELS = (
    np.array([_OFF, _OFF, _OFF, _OFF, 100.0]),
    np.array([_ON, _OFF, _OFF, _OFF, _OFF]),
    np.array([_ON, 0.1, 0.1, 0.1, _OFF]),
    np.array([_ON, _OFF, _OFF, _OFF, 20.0]),
)
# Share of pixels that a less simple change has to explain: at least, and of those not explained.
_BETTER, _UNEXPLAINED = 0.01, 0.12
_COMPLEXITY = np.array([0.0, 1.0, 1.5, 1.5])
_MAX_ADDED = 30.0  # with a factor, gray values; else position and factor can hardly be separated
_NOTED, _UNCERTAIN = 0.01, 0.05  # change of a factor, and error, that are reported
_MIN_SHARE = 0.1  # of the pixels that are not deformed

Values = Float[np.ndarray, "h w 3"]


@dataclass(frozen=True, eq=False)
class LightChange:
    """Change of the light where the gel is not deformed: a factor, and light that is added.

    Attributes:
        terms: Of each color, the factor less one in the middle of the image, its increase to the
            right, to the lower edge and with the squared distance from the middle, which are the
            same for all colors, and added gray values.
        error: Error of the factors, which is the relative one of the slopes: by how much they
            differ from those of other changes that explain the images as well.
        share: Share of the pixels that are not deformed.
    """

    terms: Float[np.ndarray, "3 5"]
    error: float
    share: float

    @property
    def factor(self) -> float:
        """Mean factor of the colors in the middle of the image."""
        return 1.0 + float(self.terms[:, 0].mean())

    @property
    def changed(self) -> bool:
        """Whether the light of a color changed by a factor."""
        return bool(np.abs(self.terms[:, :-1]).max() > _NOTED)

    @property
    def fault(self) -> str:
        """Description of a change that is not known well, or ""."""
        if self.share >= _MIN_SHARE and self.error <= _UNCERTAIN:
            return ""
        return (
            f"light not known: {self.share:.0%} of the pixels show the gel undeformed, and slopes"
            f" may be off by {self.error:.0%}"
        )

    def remove(self, image: Values, reference: Values) -> Values:
        """Return the change of an image against its reference under the reference's light."""
        factor = 1.0 + _basis(image.shape[:2]) @ self.terms[:, :-1].T
        return (image - self.terms[:, -1]) / factor - reference


def light_change(image: Values, reference: Values, known: Bool[np.ndarray, "h w"]) -> LightChange:
    """Return the change of the light, from the known pixels where the gel is not deformed.

    Image and reference have gray values. The pixels that are not deformed are those of the most
    frequent change, found by reweighted least squares from several starts. Light that is added and
    a factor differ where the reference is not equally bright everywhere. Of several changes the
    simplest is taken that explains about as many pixels as any.
    """
    usable = known & (np.maximum(image, reference).max(axis=2) < _SATURATED)
    step = max(1, round(np.sqrt(usable.size / _PIXELS)))
    size = (max(1, usable.shape[1] // step), max(1, usable.shape[0] // step))
    seen, light, share = (
        cv2.resize(values.astype(np.float64), size, interpolation=cv2.INTER_AREA)
        for values in (image, reference, usable)
    )
    usable = share > 0.99
    if not usable.any():
        return LightChange(np.zeros((3, 5)), 1.0, 0.0)
    border = usable.copy()
    border[1:-1, 1:-1] = False
    ratio = seen / np.maximum(light, 1.0) - 1
    starts = [np.zeros(3)]
    starts += [np.median(ratio[pixels], axis=0) for pixels in (usable, border) if pixels.any()]
    data = seen[usable], light[usable], _basis(usable.shape)[usable]
    return _simplest(*_fits(data, [np.pad(start[:, None], ((0, 0), (0, 4))) for start in starts]))


def _fits(
    data: tuple[np.ndarray, np.ndarray, np.ndarray], starts: list[np.ndarray]
) -> tuple[list[LightChange], list[LightChange]]:
    """Fit all models, to the pixels of a wide range of colors and of a narrow one."""
    wide = [
        max((_fit(*data, model, start, _BANDWIDTH) for start in starts), key=lambda fit: fit.share)
        for model in _MODELS[:2]
    ]
    wide += [_fit(*data, model, wide[1].terms, _BANDWIDTH) for model in _MODELS[2:]]
    pairs = zip(_MODELS, wide, strict=True)
    return wide, [_fit(*data, model, fit.terms, _NARROW) for model, fit in pairs]


def _simplest(wide: list[LightChange], narrow: list[LightChange]) -> LightChange:
    """Select the simplest change, with the difference of similar ones as error."""
    shares = np.array([fit.share for fit in narrow])
    # Less simple changes also explain some of the colors of a gel that is slightly deformed.
    unexplained = max(fit.share for fit in wide) - shares.max()
    least = _BETTER + _UNEXPLAINED * unexplained
    shares[-1] *= np.abs(narrow[-1].terms[:, -1]).max() < _MAX_ADDED
    scores = shares - least * _COMPLEXITY
    best = int(np.argmax(scores))
    found = narrow[best] if best else wide[0]
    simple = np.arange(len(shares)) < 2  # further ones explain more of a gel that is deformed
    similar = scores > scores[best] - 0.5 * least
    similar |= (shares > shares[best] - least) & (simple | bool(best))
    # Another gamma resembles a factor that rises to one side as well as one with much added light.
    factor = np.abs(narrow[-1].terms[:, 0]).max()
    similar[-1] |= best == 2 and factor < _ON and wide[-1].share > wide[best].share - least
    apart = [np.abs(narrow[k].terms - found.terms)[:, 0].max() for k in np.flatnonzero(similar)]
    return LightChange(found.terms, float(max(apart)), wide[best].share)


def _fit(
    seen: Float[np.ndarray, "n 3"],
    light: Float[np.ndarray, "n 3"],
    basis: Float[np.ndarray, "n 4"],
    prior_deviation: Float[np.ndarray, "5"],
    start: Float[np.ndarray, "3 5"],
    bandwidth: float,
) -> LightChange:
    """Fit a change by mean shift (Comaniciu and Meer, 2002)."""
    change, added = seen - light, np.ones((len(basis), 1))
    designs = np.stack([np.hstack([basis * light[:, [k]], added]) for k in range(3)])
    prior, terms = np.diag(prior_deviation**-2.0), start.copy()
    for _ in range(_MAX_ITERATIONS):
        before = terms.copy()
        off = change - np.einsum("knp,kp->nk", designs, terms)
        weight = np.exp(-0.5 * (off**2).sum(axis=1) / bandwidth**2)
        weighted = designs.swapaxes(1, 2) * weight
        terms = np.linalg.solve(weighted @ designs + prior, weighted @ change.T[..., None])[..., 0]
        # Gradients that differ between the colors are slopes of the gel.
        terms[:, 1:-1] = terms[:, 1:-1].mean(axis=0)
        if np.abs(terms - before).max() < _TOLERANCE:
            break
    return LightChange(terms, 0.0, float(weight.mean()))


def _basis(shape: tuple[int, ...]) -> Float[np.ndarray, "h w 4"]:
    """Constant, positions from -1 to 1, and squared distance from the center."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    return np.stack([np.ones_like(x), x, y, x**2 + y**2], axis=-1)
