"""What is fitted to samples: shifts of edges, and the kernel machine of the second stage."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag, cholesky, solve_triangular
from scipy.optimize import minimize
from sklearn.cluster import MiniBatchKMeans
from sklearn.decomposition import PCA
from sklearn.linear_model import Ridge
from sklearn.metrics.pairwise import rbf_kernel
from sklearn.preprocessing import StandardScaler
from sklearn.utils.class_weight import compute_sample_weight

from vehicle_detection.two_stage.features import N_BORDERS
from vehicle_detection.two_stage.model import KernelMachine

if TYPE_CHECKING:
    from vehicle_detection.parameters import TrainingParams
    from vehicle_detection.two_stage.training.sampling import PatchSamples

# Of the kernel of the centers, whose diagonal is 1.
_LEAST_EIGENVALUE = 1e-5


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


def fit_shifts(features: np.ndarray, shifts: np.ndarray, alpha: float) -> tuple:
    """Ridge regression; scaling is folded into its weights.

    Parameters
    ----------
    features : ndarray of float32, shape (n, n_features)
    shifts : ndarray of float, shape (n, 4)
    alpha : float

    Returns
    -------
    weights : ndarray of float32, shape (n_features, 4)
    bias : ndarray of float32, shape (4,)
    """
    scaler = StandardScaler().fit(features)
    ridge = Ridge(alpha=alpha).fit(scaler.transform(features), shifts)
    weights = ridge.coef_ / scaler.scale_
    bias = ridge.intercept_ - weights @ scaler.mean_
    return weights.T.astype(np.float32), bias.astype(np.float32)


def fit_machine(
    samples: PatchSamples, rng: np.random.Generator, params: TrainingParams
) -> KernelMachine:
    """The second stage: a linear SVM and ridge regressions on one map of the samples.

    The map approximates an RBF kernel by clusters of the samples, as many of vehicles as of
    anything else. A kernel SVM on as many samples would keep thousands of support vectors,
    and each costs time in every frame.

    The decision function is scaled so that the vehicles it learned from have a median of
    `params.vehicle_score`: how much evidence a score is must not depend on C.

    Parameters
    ----------
    samples : PatchSamples
    rng : numpy.random.Generator
    params : TrainingParams

    Returns
    -------
    machine : KernelMachine
        Its outputs are the decision function and the four shifts.

    References
    ----------
    .. [1] C. Williams and M. Seeger, "Using the Nystroem Method to Speed Up
           Kernel Machines", NIPS 2000.
    .. [2] K. Zhang, I. Tsang and J. Kwok, "Improved Nystroem Low-Rank
           Approximation and Error Analysis", ICML 2008.
    """
    clear = rng.permutation(np.flatnonzero(samples.labels >= 0))[: params.most_patches]
    features, labels = samples.features[clear], samples.labels[clear]
    print(f"patches: {len(clear)}, {labels.mean():.0%} vehicles")
    n_components, n_centers = params.machine_size
    projection, offset = fit_components(features, n_components, rng)
    components = apply_components(features, projection, offset)
    gamma = float(1 / components[:, :n_components].var(axis=0).sum())
    centers = np.concatenate(
        [cluster_centers(components[labels == label], n_centers // 2) for label in (0, 1)]
    )
    factor = kernel_factor(centers, gamma)
    mapped = kernel_map(components, centers, gamma, factor)
    coef, intercept = fit_linear_svm(mapped, labels, params.machine_C)
    scale = params.vehicle_score / np.median(mapped[labels > 0] @ coef + intercept)
    known = rng.permutation(np.flatnonzero(~np.isnan(samples.shifts[:, 0])))[: params.most_patches]
    print(f"edges: {len(known)} patches")
    components = apply_components(samples.features[known], projection, offset)
    # The one before goes first: each takes more than a gigabyte.
    del mapped
    mapped = kernel_map(components, centers, gamma, factor)
    ridge = Ridge(params.machine_alpha, solver="cholesky", copy_X=False)
    ridge.fit(mapped, samples.shifts[known])
    coefs = np.vstack([scale * coef, ridge.coef_])
    weights = solve_triangular(factor, coefs.T, lower=True, trans="T").T
    # One row after the other, as they are multiplied.
    weights = weights.astype(np.float32, order="C")
    bias = np.array([scale * intercept, *ridge.intercept_], np.float32)
    return KernelMachine(projection, offset, centers.astype(np.float32), weights, bias, gamma)


def kernel_factor(centers: np.ndarray, gamma: float) -> np.ndarray:
    """Cholesky factor of the RBF kernel of the centers, lower, float32, shape (n, n)."""
    kernel = rbf_kernel(centers.astype(float), gamma=gamma)
    # Rounding must not make it indefinite.
    kernel[np.diag_indices_from(kernel)] += _LEAST_EIGENVALUE
    return cholesky(kernel, lower=True, overwrite_a=True).astype(np.float32)


def kernel_map(
    samples: np.ndarray, centers: np.ndarray, gamma: float, factor: np.ndarray, n_rows: int = 5000
) -> np.ndarray:
    """Nystroem's map: products of mapped samples approximate their RBF kernel.

    A rotation of scikit-learn's `Nystroem`, whose decomposition takes far longer; to a
    linear SVM both are the same.

    Parameters
    ----------
    samples : ndarray of float32, shape (n, n_components)
    centers : ndarray of float32, shape (n_centers, n_components)
    gamma : float
    factor : ndarray
        See `kernel_factor`.
    n_rows : int
        So many samples at a time.

    Returns
    -------
    mapped : ndarray of float32, shape (n, n_centers)
    """
    mapped = np.empty((len(samples), len(centers)), np.float32)
    for i in range(0, len(samples), n_rows):
        kernel = rbf_kernel(samples[i : i + n_rows], centers, gamma)
        mapped[i : i + n_rows] = solve_triangular(factor, kernel.T, lower=True).T
    return mapped


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
