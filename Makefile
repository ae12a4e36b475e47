# The two commands of the README, and what they need from Debian.

# The orchestrator, and beside it the programs that pack units with the units' libraries.
PROGRAMS = -p orchestrator -p mechanics-unit -p flow-unit

.PHONY: test run check bench deps

# The tests run the programs.
test: deps
	cargo build $(PROGRAMS)
	cargo test --workspace
	tests/fmi/run
	tests/units/run

run: deps
	cargo build --release $(PROGRAMS)
	target/release/orchestrator run models/six-fractures --overwrite

# What CI runs besides the tests.
check: deps
	cargo fmt --all --check
	cargo clippy --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps

bench: deps
	cargo bench -p linear
	cargo bench -p tests --bench mechanics
	cargo bench -p fmi-unit

# The HDF5 library and its headers; needs root where they are missing.
deps:
	@pkg-config --exists hdf5 2>/dev/null || dpkg -s libhdf5-dev >/dev/null 2>&1 || \
	  (apt-get update -q && apt-get install -y -q --no-install-recommends libhdf5-dev pkg-config)
