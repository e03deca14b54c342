"""The files of a site: `site.toml`, targets, lenses."""
