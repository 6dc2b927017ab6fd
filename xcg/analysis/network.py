"""The contact network: an adjacency matrix, a graph of networkx, and clusters that may reach through the box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import check_choice, extra
from xcg.compiled.contacts import join_clusters
from xcg.scene.conform import takes_scene
from xcg.scene.contacts import Contacts
from xcg.scene.frame import frame_at, step_at
from xcg.scene.lattice import unit_vectors
from xcg.scene.scene import Scene
from xcg.scene.schema import Frame

if TYPE_CHECKING:
    import networkx as nx
    from scipy.sparse import csr_array

EdgeWeight: TypeAlias = Literal["contacts", "force", "overlap"]
CONTACTS = ("contact_i", "contact_j", "contact_point")
# variables that attributes of edges follow from
_VARIABLES = {"force": "contact_force", "overlap": "overlap"}


@takes_scene
def adjacency(scene: Scene, index: int = -1, *, weight: EdgeWeight | None = None) -> csr_array:
    r"""Return the adjacency matrix of the contacts between the grains of one step.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with contacts.
    index : int
        Position of the step in time; the last one by default.
    weight : {"contacts", "force", "overlap"}, optional
        What entries are: 1 where grains touch (default), the number of their contacts, the
        magnitude of the sum of their contact forces (N), or the largest of their overlaps (m).

    Returns
    -------
    scipy.sparse.csr_array
        Square and symmetric; row k is that of the k-th grain by id. Walls, and partners that the
        step does not hold, have no row.

    Raises
    ------
    SceneError
        If the scene has no contacts, or no variable for the weight.
    ValueError
        If the step does not exist, or `weight` is another.

    See Also
    --------
    contact_graph : With walls, vectors and the variables of grains, for networkx.

    Notes
    -----
    :math:`A_{ij} = A_{ji}` is 1 for each pair of grains in contact, so that :math:`\sum_j A_{ij}`
    is the degree of grain i: its coordination number without walls. Source: Walker, D. M.,
    Tordesillas, A. (2010). Topological evolution in dense granular materials: a complex networks
    perspective. Int. J. Solids Struct. 47.

    Examples
    --------
    >>> import xcg
    >>> matrix = xcg.datasets.face_centred_cubic(3).cg.adjacency()
    >>> float(matrix.sum(axis=1).max())
    12.0
    """
    from scipy.sparse import csr_array

    if weight is not None:
        check_choice("weight", weight, EdgeWeight)
    needed = [name for part, name in _VARIABLES.items() if part == weight]
    scene.require([*CONTACTS, *needed], "adjacency")
    frame, contacts = _contacts_at(scene.ds, index, needed)
    pairs = _edges(frame, contacts)
    count = len(frame["particle_id"])
    i = pairs["i"]
    j = pairs["j"]
    values = np.ones(len(i))
    if weight is not None:
        values = pairs[weight].astype(float)
    if weight == "force":
        values = np.linalg.norm(values, axis=1)
    ends = (np.concatenate([i, j]), np.concatenate([j, i]))
    return csr_array((np.tile(values, 2), ends), shape=(count, count))


@takes_scene
def contact_graph(scene: Scene, index: int = -1, *, include_walls: bool = False) -> nx.Graph:
    """Return the contact network of one step as a graph of networkx.

    Nodes are grains by ``particle_id``, frozen ones included, with the scene's variables of the
    grain in this step as attributes: numbers, and vectors as arrays. Edges are pairs of grains in
    contact.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with contacts.
    index : int
        Position of the step in time; the last one by default.
    include_walls : bool
        Add walls as nodes by their negative number. Nodes have the attribute ``wall``, True for
        these.

    Returns
    -------
    networkx.Graph
        Each edge has, summed over the contacts of its pair,

        - ``i``, ``j``: its ends, which signs refer to: of two grains i has the lower id, and j is
          the wall;
        - ``contacts``: their number;
        - ``force`` (3,): the force **on i** by j (N), if the scene has forces;
        - ``normal`` (3,): unit vector of the sum of their normals, each from j to i; zero where
          they cancel, as between grains that touch on both sides of a periodic box;
        - ``overlap``: the largest of theirs (m), if the scene has overlaps.

        The graph has the attributes ``time`` and ``step``.

    Raises
    ------
    ImportError
        If networkx is not installed.
    SceneError
        If the scene has no contacts.
    ValueError
        If the step does not exist.

    See Also
    --------
    adjacency : The same network as a sparse matrix, without networkx.
    microstructure : Clusters, percolation and the distribution of degrees over time.

    Notes
    -----
    Source: Papadopoulos, L., Porter, M. A., Daniels, K. E., Bassett, D. S. (2018). Network analysis
    of particles and grains. J. Complex Networks 6.

    Examples
    --------
    >>> import xcg
    >>> graph = xcg.datasets.simple_cubic(4).cg.contact_graph()  # doctest: +SKIP
    >>> graph.degree[0]  # doctest: +SKIP
    6
    """
    nx = extra("networkx", "network", "contact_graph")
    scene.require(CONTACTS, "contact_graph")
    ds = scene.ds
    of_grains = [str(name) for name in ds.data_vars if "particle" in ds[name].dims]
    frame, contacts = _contacts_at(ds, index, [*of_grains, *_VARIABLES.values()])
    pairs = _edges(frame, contacts, walls=include_walls)
    coords = step_at(ds, index).coords
    graph = nx.Graph(
        **{name: coords[name].values.item() for name in ("time", "step") if name in coords}
    )
    ids = np.concatenate([frame["particle_id"], pairs["walls"]]).tolist()
    columns = {name: _entries(frame[name]) for name in of_grains if name != "particle_id"}
    for k, node in enumerate(ids[: len(frame["particle_id"])]):
        graph.add_node(node, wall=False, **{name: values[k] for name, values in columns.items()})
    graph.add_nodes_from(pairs["walls"].tolist(), wall=True)
    names = ["contacts", "normal"] + [name for name, of in _VARIABLES.items() if of in frame]
    columns = {name: _entries(pairs[name]) for name in names}
    for k, (i, j) in enumerate(zip(pairs["i"], pairs["j"], strict=True)):
        attributes = {name: values[k] for name, values in columns.items()}
        graph.add_edge(ids[i], ids[j], i=ids[i], j=ids[j], **attributes)
    return graph


def _entries(values: NDArray) -> Sequence[Any]:
    """Rows of an array: Python's numbers, or arrays."""
    if values.ndim == 1:
        return values.tolist()
    return [row.copy() for row in values]


def _contacts_at(ds: xr.Dataset, index: int, names: Sequence[str]) -> tuple[Frame, Contacts]:
    """Read some variables of a step, and its contacts."""
    wanted = {"particle_id", "position", *CONTACTS, "contact_normal", *names}
    frame, lattice, source = frame_at(ds, index, wanted)
    return frame, Contacts.of(frame, lattice, source)


def _edges(frame: Frame, contacts: Contacts, *, walls: bool = False) -> Frame:
    """Pairs in contact, each once: rows i < j, rows of walls after the grains', and sums over their contacts."""
    count = len(contacts.position)
    # of the partner, where only one grain is there
    key = np.where(contacts.i < 0, contacts.key_i, contacts.key_j)
    at_wall = walls & (key < 0) & (contacts.first_index >= 0)
    numbers, wall = np.unique(key[at_wall], return_inverse=True)
    ends = np.stack([contacts.i, contacts.j])
    ends[:, at_wall] = np.where(ends[:, at_wall] < 0, count + wall, ends[:, at_wall])
    kept = (ends >= 0).all(axis=0)
    ends = ends[:, kept]
    sign = np.where(ends[0] <= ends[1], 1.0, -1.0)[:, None]
    nodes = count + len(numbers)
    number = ends.min(axis=0) * nodes + ends.max(axis=0)
    numbers_of_pairs, pair, many = np.unique(number, return_inverse=True, return_counts=True)
    i, j = divmod(numbers_of_pairs, nodes)
    force = np.zeros((len(i), 3))
    normal = np.zeros((len(i), 3))
    np.add.at(force, pair, sign * contacts.force[kept])
    np.add.at(normal, pair, sign * contacts.normal[kept])
    overlap = np.full(len(i), -np.inf)
    np.maximum.at(overlap, pair, frame.get("overlap", np.zeros(len(key)))[kept])
    return {
        "i": i,
        "j": j,
        "walls": numbers,
        "contacts": many,
        "force": force,
        "normal": unit_vectors(normal),
        "overlap": overlap,
    }


@dataclass(frozen=True, eq=False)
class Clusters:
    """Clusters of some grains of a frame: grains that contacts between them connect, single ones included.

    Attributes
    ----------
    contacts : Contacts
        Contacts of the frame.
    member : array (particles,)
        Whether each grain is one of them.
    """

    contacts: Contacts
    member: NDArray

    @cached_property
    def _joined(self) -> tuple[NDArray, NDArray]:
        """Root of the cluster of each grain (particles,), and along which lattice vectors that winds (particles, k)."""
        contacts = self.contacts
        is_member = np.append(self.member, False)  # index -1 is that of a wall
        lattice = contacts.lattice
        count = len(self.member)
        index_i = np.where(is_member[contacts.i], contacts.i, -1)
        index_j = np.where(is_member[contacts.j], contacts.j, -1)
        # in numbers of the vectors of the axes, which reduced ones of tilted boxes are sums of
        numbers = contacts.crossed @ lattice.basis @ np.linalg.pinv(lattice.periodic_vectors)
        crossed = np.rint(numbers).astype("int64")
        root = np.arange(count)
        moved = np.zeros((count, crossed.shape[1]), "int64")
        winds = np.zeros(moved.shape, bool)
        join_clusters(index_i, index_j, crossed, root, moved, winds)
        return root, winds

    @property
    def size(self) -> NDArray:
        """Number of grains of each cluster; (clusters,)."""
        return np.unique(self._joined[0][self.member], return_counts=True)[1]

    @property
    def spans(self) -> NDArray:
        """Return whether any cluster reaches through the box along x, y, z; (3,).

        Along a periodic axis a cluster does so if it winds around the box; along the others if it
        touches walls on both sides, those whose contacts' normals have their largest component
        along this axis.
        """
        root, winds = self._joined
        contacts = self.contacts
        through = np.zeros((len(root), 3), bool)
        periodic = np.isfinite(contacts.lattice.lengths)
        through[:, periodic] = winds
        sides = np.zeros((len(root), 3, 2), bool)
        for index, other, sign in ((contacts.i, contacts.j, 1.0), (contacts.j, contacts.i, -1.0)):
            at_wall = np.flatnonzero((index >= 0) & (other < 0))
            at_wall = at_wall[self.member[index[at_wall]]]
            normal = sign * contacts.normal[at_wall]
            axis = np.abs(normal).argmax(axis=1)
            sides[
                root[index[at_wall]], axis, (normal[range(len(at_wall)), axis] < 0).astype(int)
            ] = True
        through[:, ~periodic] = np.asarray(sides.all(axis=2))[:, ~periodic]
        return np.asarray(through[root[self.member]].any(axis=0))
