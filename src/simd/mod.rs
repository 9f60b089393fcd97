//! Eight lanes: the only place for intrinsics. Chosen once at start, dispatched per call of a query, never per node.
