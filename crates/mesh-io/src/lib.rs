//! mesh-io
