"""Kernel machines fitted to features: the scorer and the regressor of the second stage."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import minimize
from sklearn.cluster import MiniBatchKMeans
from sklearn.decomposition import PCA
from sklearn.kernel_approximation import Nystroem
from sklearn.linear_model import Ridge
from sklearn.metrics.pairwise import rbf_kernel
from sklearn.preprocessing import StandardScaler
from sklearn.utils.class_weight import compute_sample_weight

from vehicle_detection.two_stage.features import N_BORDERS
from vehicle_detection.two_stage.model import KernelMachine

if TYPE_CHECKING:
    from vehicle_detection.parameters import TrainingParams


def fit_components(features: np.ndarray, n_components: int, rng: np.random.Generator) -> tuple:
    """Scaling and principal components of cells, borders apart; as an affine map, float32."""
    if len(features) < n_components:
        raise ValueError(f"only {len(features)} patches to learn from: give more footage")
    chosen = rng.permutation(len(features))[:15_000]
    scaler = StandardScaler()
    # Cells that are nearly always empty would weigh most if they were scaled up.
    some = scaler.fit_transform(features[chosen, :-N_BORDERS].astype(np.float32))
    scale = np.maximum(scaler.scale_, 0.01)
    some *= scaler.scale_ / scale
    pca = PCA(n_components, svd_solver="randomized", random_state=0).fit(some)
    projection = pca.components_ / scale
    offset = -(projection @ scaler.mean_) - pca.components_ @ pca.mean_
    # A margin outside of the frame is as far from one inside as one patch from another.
    border = np.sqrt(2 * pca.explained_variance_.sum()) * np.eye(N_BORDERS)
    projection = block_diag(projection, border)
    offset = np.concatenate([offset, np.zeros(N_BORDERS)])
    return projection.astype(np.float32), offset.astype(np.float32)


def apply_components(
    features: np.ndarray, projection: np.ndarray, offset: np.ndarray, n_rows: int = 5000
) -> np.ndarray:
    """Components of many features, a part at a time."""
    parts = (features[i : i + n_rows] for i in range(0, len(features), n_rows))
    return np.concatenate([part.astype(np.float32) @ projection.T + offset for part in parts])


def fit_regressor(
    features: np.ndarray, shifts: np.ndarray, rng: np.random.Generator, params: Any
) -> KernelMachine:
    """Ridge regression on Gaussians around some of the samples, fitted twice.

    First on many principal components, the directions along which patches differ
    most; then on those few along which the first fit changes most, for they say
    where the edges are: what colour a vehicle has does not.

    References
    ----------
    .. [1] A. Radhakrishnan, D. Beaglehole, P. Pandit and M. Belkin, "Mechanism
           for feature learning in neural networks and backpropagation-free
           machine learning models", Science 383, 2024.
    """
    n_components, n_centers = params.regressor_size
    n_principal = min(params.n_principal, len(features), features.shape[1] - N_BORDERS)
    projection, offset = fit_components(features, max(n_components, n_principal), rng)
    components = apply_components(features, projection, offset)
    chosen = rng.permutation(len(components))
    centers = components[chosen[:n_centers]]
    first, gamma = fit_ridge(components, centers, shifts, params.ridge_alpha)
    some = components[chosen[: params.n_gradients]]
    directions = steepest_directions(some, centers, first.coef_, gamma, n_components)
    components, centers = components @ directions.T, centers @ directions.T
    ridge, gamma = fit_ridge(components, centers, shifts, params.ridge_alpha)
    # One row after the other, as they are multiplied.
    weights = ridge.coef_.astype(np.float32, order="C")
    bias = ridge.intercept_.astype(np.float32)
    return KernelMachine(
        directions @ projection, directions @ offset, centers, weights, bias, gamma
    )


def fit_ridge(
    components: np.ndarray, centers: np.ndarray, targets: np.ndarray, alpha: float
) -> tuple:
    """Ridge regression on Gaussians, and their gamma: one by the sum of the variances."""
    gamma = float(1 / components.var(axis=0).sum())
    kernel = rbf_kernel(components.astype(float), centers.astype(float), gamma)
    return Ridge(alpha=alpha, solver="cholesky").fit(kernel, targets), gamma


def steepest_directions(
    components: np.ndarray,
    centers: np.ndarray,
    weights: np.ndarray,
    gamma: float,
    count: int,
    power: float = 0.35,
) -> np.ndarray:
    """Directions in which f(x) = sum_i weights_i exp(-gamma |x - centers_i|^2) changes most.

    Parameters
    ----------
    components : ndarray, shape (n, n_components)
        Where to look at f.
    centers : ndarray, shape (n_centers, n_components)
    weights : ndarray, shape (n_outputs, n_centers)
    gamma : float
    count : int
    power : float
        Of the eigenvalues. 1/2 would give the gradients' own lengths, and leave too
        little of all directions but the steepest.

    Returns
    -------
    directions : ndarray of float32, shape (count, n_components)
        Eigenvectors of the sum of the gradients' outer products, the steepest first
        and of length 1, the others as much shorter as their eigenvalues are smaller.
    """
    kernel = rbf_kernel(components, centers, gamma)
    outer = np.zeros((components.shape[1],) * 2)
    for own in weights:
        pull = kernel * own
        gradients = pull @ centers - pull.sum(axis=1, keepdims=True) * components
        outer += gradients.T @ gradients
    values, vectors = np.linalg.eigh(outer)
    values, vectors = values[::-1][:count], vectors[:, ::-1][:, :count]
    lengths = np.maximum(values / values[0], 0) ** power
    return (vectors * lengths).T.astype(np.float32)


def fit_scorer(
    features: np.ndarray, labels: np.ndarray, rng: np.random.Generator, params: TrainingParams
) -> KernelMachine:
    """Linear SVM on the map that approximates an RBF kernel by clusters of the samples.

    Its decision function is scaled so that the vehicles it learned from have a median of
    `params.vehicle_score`: how much evidence a score is must not depend on C.

    A kernel SVM on as many samples would keep thousands of support vectors,
    and each costs time in every frame. As many clusters are of vehicles as of
    anything else.

    Parameters
    ----------
    features : ndarray of float16, shape (n, N_SCORER_FEATURES)
        See `features.scorer_features`: the last are the margins outside of the frame.
    labels : ndarray, shape (n,)
        Positive for vehicles.
    rng : numpy.random.Generator
    params : TrainingParams

    Returns
    -------
    scorer : KernelMachine

    References
    ----------
    .. [1] C. Williams and M. Seeger, "Using the Nystroem Method to Speed Up
           Kernel Machines", NIPS 2000.
    .. [2] K. Zhang, I. Tsang and J. Kwok, "Improved Nystroem Low-Rank
           Approximation and Error Analysis", ICML 2008.
    """
    print(f"patches: {len(labels)}, {labels.mean():.0%} vehicles")
    n_components, n_centers = params.scorer_size
    projection, offset = fit_components(features, n_components, rng)
    components = apply_components(features, projection, offset)
    gamma = float(1 / components[:, :n_components].var(axis=0).sum())
    centers = np.concatenate(
        [cluster_centers(components[labels == label], n_centers // 2) for label in (0, 1)]
    )
    nystroem = Nystroem(gamma=gamma, n_components=len(centers), random_state=0).fit(centers)
    mapped = nystroem.transform(components).astype(np.float32)
    coef, intercept = fit_linear_svm(mapped, labels, params.scorer_C)
    scale = params.vehicle_score / np.median(mapped[labels > 0] @ coef + intercept)
    weights = (scale * (nystroem.normalization_.T @ coef))[None].astype(np.float32)
    centers = nystroem.components_.astype(np.float32)
    bias = np.array([scale * intercept], np.float32)
    return KernelMachine(projection, offset, centers, weights, bias, gamma)


def fit_linear_svm(features: np.ndarray, labels: np.ndarray, C: float) -> tuple:
    """Linear SVM with squared hinge loss and balanced classes, in the primal [1]_.

    The problem of `sklearn.svm.LinearSVC`, which copies the features in double precision.

    Parameters
    ----------
    features : ndarray of float32, shape (n, n_features)
    labels : ndarray of int, shape (n,)
        1 or 0.
    C : float

    Returns
    -------
    coef : ndarray of float, shape (n_features,)
    intercept : float

    References
    ----------
    .. [1] O. Chapelle, "Training a Support Vector Machine in the Primal", Neural
           Computation 19, 2007.
    """
    signs = np.where(labels > 0, 1, -1).astype(np.float32)
    costs = (C * compute_sample_weight("balanced", labels)).astype(np.float32)

    def objective(solution):
        """Half the squared length and the losses, and the gradient."""
        coef = solution.astype(np.float32)
        slack = np.maximum(0, 1 - signs * (features @ coef[:-1] + coef[-1]))
        pull = -2 * costs * signs * slack
        gradient = np.append(pull @ features, pull.sum(dtype=float)) + solution
        return (costs * slack**2).sum(dtype=float) + solution @ solution / 2, gradient

    start = np.zeros(features.shape[1] + 1)
    found = minimize(objective, start, jac=True, method="L-BFGS-B", options={"maxiter": 300})
    return found.x[:-1], found.x[-1]


def cluster_centers(components: np.ndarray, count: int) -> np.ndarray:
    """Centers of clusters, or the samples themselves if they are fewer; shape (n, n_components)."""
    if len(components) <= count:
        return components
    clusters = MiniBatchKMeans(
        count, init="random", n_init=1, batch_size=4096, max_iter=10, random_state=0
    )
    return clusters.fit(components).cluster_centers_
