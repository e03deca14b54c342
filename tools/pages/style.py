"""The report's style: one sheet, light and dark, wide and narrow, screen and paper."""

_CAMERAS_LIGHT = (
    "#2563a8", "#b9501c", "#1c7a5a", "#a03a80", "#846500", "#5a4ab5", "#0a7786", "#b0323f",
)  # fmt: skip
_CAMERAS_DARK = (
    "#7db4f0", "#f09a63", "#5fc9a0", "#e58ac6", "#d9b64a", "#aaa0f5", "#56c7d6", "#f08a94",
)  # fmt: skip


PALETTE = len(_CAMERAS_LIGHT)
"""How many colours there are for cameras."""


def _cameras(colours: tuple[str, ...]) -> str:
    return "".join(f".k{i}{{--k:{colour}}}" for i, colour in enumerate(colours))


STYLE = f"""
:root {{
  --paper:#fbfaf7; --card:#ffffff; --ink:#1c2024; --soft:#5b636b; --faint:#8b939b; --rule:#e3e1da;
  --wall:#4a5058; --true:#c9cdd1; --live:#10151a; --reckoned:#cf4a32; --bar:#2563a8; --good:#1c7a5a;
  --bad:#b3261e; color-scheme:light;
}}
{_cameras(_CAMERAS_LIGHT)}
@media screen and (prefers-color-scheme: dark) {{
  :root {{
    --paper:#14171a; --card:#1b1f23; --ink:#e8eaec; --soft:#a4acb4; --faint:#78818a; --rule:#2c3238;
    --wall:#9aa3ac; --true:#464e56; --live:#f2f4f5; --reckoned:#ff8a70; --bar:#7db4f0;
    --good:#5fc9a0; --bad:#ff8a80; color-scheme:dark;
  }}
  {_cameras(_CAMERAS_DARK)}
  .floor-plan {{ filter:invert(1); mix-blend-mode:screen }}
}}
* {{ box-sizing:border-box }}
body {{
  margin:0; background:var(--paper); color:var(--ink);
  font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Noto Sans",sans-serif;
  font-variant-numeric:tabular-nums;
}}
main {{ max-width:1080px; margin:0 auto; padding:40px 24px 64px }}
.brand {{ display:flex; align-items:center; gap:10px; color:var(--soft); font-size:15px }}
.brand svg {{ width:22px; height:22px }}
.brand path {{ fill:none; stroke:var(--ink); stroke-width:2; stroke-linejoin:round }}
.brand circle {{ fill:var(--reckoned) }}
h1 {{ font-size:34px; line-height:1.18; letter-spacing:-.015em; margin:18px 0 10px; max-width:24em;
  text-wrap:balance }}
h2 {{ font-size:21px; letter-spacing:-.005em; margin:52px 0 4px }}
h3 {{ font-size:16px; margin:0 0 6px }}
p {{ margin:0 0 12px; max-width:44em }}
.lead {{ font-size:18px; color:var(--soft) }}
.quiet, .note {{ color:var(--soft); font-size:14.5px }}
.scroll + .note {{ margin-top:12px }}
.failures {{ border-left:4px solid var(--bad); padding:8px 16px; margin:20px 0;
  background:var(--card) }}
.failures li {{ margin:2px 0 }}
.tiles {{ display:grid; grid-template-columns:repeat(auto-fit,minmax(178px,1fr)); gap:12px;
  margin:26px 0 8px }}
.tile {{ background:var(--card); border:1px solid var(--rule); border-radius:10px;
  padding:14px 16px }}
.tile b {{ display:block; font-size:27px; line-height:1.2; letter-spacing:-.01em; font-weight:650 }}
.tile span {{ display:block; color:var(--soft); font-size:14px; line-height:1.4; margin-top:4px }}
.tile.bad b {{ color:var(--bad) }}
.card {{ background:var(--card); border:1px solid var(--rule); border-radius:10px;
  padding:16px 18px }}
figure {{ margin:0 }}
svg {{ display:block; width:100%; height:auto }}
svg text {{ fill:var(--soft); font-size:13px }}
.upright {{ display:none }}
.walls line {{ stroke:var(--wall); stroke-width:3; stroke-linecap:round }}
.floor-plan {{ opacity:.55; mix-blend-mode:multiply }}
.corrected-floor {{ opacity:.75; image-rendering:pixelated }}
.c0 {{ fill:#1a7f5a }} .c1 {{ fill:#63b179 }} .c2 {{ fill:#d9c45b }} .c3 {{ fill:#e39a4b }}
.c4 {{ fill:#c96f4a }} .c5 {{ fill:#a2313a }}
.view {{ fill:var(--k); fill-opacity:.13; stroke:none }}
svg .name {{ fill:var(--k); font-weight:650; font-size:16px; text-anchor:middle }}
.way {{ fill:none; stroke-linejoin:round; stroke-linecap:round }}
.way.true {{ stroke:var(--true); stroke-width:7 }}
.way.corrected {{ stroke:var(--live); stroke-width:1.7 }}
.way.reckoned {{ stroke:var(--reckoned); stroke-width:1.7; stroke-dasharray:5 4 }}
.start {{ fill:var(--card); stroke:var(--live); stroke-width:2 }}
.end {{ fill:var(--live) }}
.true-place {{ fill:none; stroke:var(--k); stroke-width:2 }}
.found {{ fill:var(--k) }}
.ellipse {{ fill:var(--k); fill-opacity:.24; stroke:var(--k); stroke-width:1.3 }}
.outline {{ fill:none; stroke:var(--k); stroke-width:1.3; stroke-dasharray:3 3 }}
.error {{ stroke:var(--k); stroke-width:1.3 }}
.scale line {{ stroke:var(--soft); stroke-width:1.5 }}
.legend {{ list-style:none; margin:14px 0 0; padding:0; display:grid; gap:4px 28px;
  grid-template-columns:repeat(auto-fit,minmax(min(300px,100%),1fr));
  color:var(--soft); font-size:14.5px }}
.legend li {{ display:flex; gap:10px; align-items:flex-start }}
.legend svg {{ width:34px; height:14px; flex:none; margin-top:5px }}
.closeups {{ display:grid; grid-template-columns:repeat(auto-fill,minmax(150px,1fr)); gap:12px;
  margin-top:14px }}
.closeups figure {{ background:var(--card); border:1px solid var(--rule); border-radius:10px;
  padding:10px 12px 12px }}
figcaption {{ font-size:13.5px; color:var(--soft); line-height:1.35; margin-top:6px }}
figcaption b {{ color:var(--k); font-size:15px; margin-right:4px }}
.rings circle, .rings line {{ fill:none; stroke:var(--rule); stroke-width:1 }}
svg .ring-text {{ fill:var(--faint); font-size:12px }}
.charts {{ display:grid; gap:14px; margin-top:14px;
  grid-template-columns:repeat(auto-fit,minmax(min(400px,100%),1fr)) }}
.grid {{ stroke:var(--rule); stroke-width:1 }}
.axis {{ stroke:var(--faint); stroke-width:1 }}
svg .tick {{ font-size:12px; fill:var(--faint) }}
svg .axis-title {{ font-size:12.5px }}
.middle {{ text-anchor:middle }}
.end-anchored {{ text-anchor:end }}
.series {{ fill:none; stroke:var(--k); stroke-width:2; stroke-linejoin:round }}
svg .series-text {{ fill:var(--k); font-weight:600 }}
svg .corrected-text {{ fill:var(--live); font-weight:600 }}
svg .reckoned-text {{ fill:var(--reckoned); font-weight:600 }}
.bar {{ fill:var(--bar); fill-opacity:.55 }}
.whisker {{ stroke:var(--bar); stroke-width:2 }}
.dot {{ fill:var(--bar) }}
.paper-band {{ fill:var(--bar); fill-opacity:.09 }}
.mark {{ stroke:var(--ink); stroke-width:1.2; stroke-dasharray:4 3 }}
svg .mark-text {{ fill:var(--ink) }}
.dots {{ stroke:var(--bar); stroke-width:3; stroke-linecap:round; fill:none; stroke-opacity:.45 }}
.picture-frame {{ fill:none; stroke:var(--soft); stroke-width:1 }}
.arrow {{ stroke:var(--reckoned); stroke-width:1.6 }}
.picture {{ fill:var(--card); stroke:var(--faint); stroke-width:1 }}
.shade rect {{ fill:var(--k) }}
.residuals line {{ stroke:var(--ink); stroke-width:1 }}
.residuals circle {{ fill:var(--k) }}
.wild line {{ stroke:var(--bad); stroke-width:1.4 }}
.normal {{ fill:none; stroke:var(--ink); stroke-width:1.4 }}
.next {{ fill:var(--good); stroke:var(--card); stroke-width:1 }}
svg .next-text {{ fill:var(--card); font-weight:700; font-size:12px; text-anchor:middle }}
.tiles.thirds {{ grid-template-columns:repeat(3,1fr) }}
.pair {{ display:grid; gap:14px 30px; align-items:start; margin-top:12px;
  grid-template-columns:repeat(auto-fit,minmax(min(300px,100%),1fr)) }}
.pair > * {{ min-width:0; overflow-x:auto }}
.camera {{ margin-top:14px }}
.camera summary {{ margin:0; font-size:16px }}
.camera summary b {{ color:var(--k); font-size:18px }}
.camera .bar {{ fill:var(--k) }}
.narrow {{ max-width:430px }}
.scroll {{ overflow-x:auto; margin-top:14px }}
table {{ border-collapse:collapse; width:100%; font-size:15px }}
th, td {{ text-align:right; padding:7px 12px; border-bottom:1px solid var(--rule);
  white-space:nowrap }}
th {{ color:var(--soft); font-weight:500; font-size:13.5px; vertical-align:bottom }}
th:first-child, td:first-child {{ text-align:left; padding-left:2px }}
td .disc {{ display:inline-block; width:10px; height:10px; border-radius:50%; background:var(--k);
  margin-right:9px }}
td.words, th.words {{ text-align:left; white-space:normal }}
tr.sum td {{ border-bottom:none; font-weight:600 }}
.bad-text {{ color:var(--bad); font-weight:600 }}
code, pre {{ font-family:ui-monospace,"SF Mono",Menlo,Consolas,"DejaVu Sans Mono",monospace;
  font-size:14px }}
pre {{ background:var(--card); border:1px solid var(--rule); border-radius:10px; padding:12px 16px;
  overflow-x:auto; margin:8px 0 18px }}
summary {{ cursor:pointer; color:var(--soft); margin-top:12px }}
footer {{ margin-top:56px; padding-top:14px; border-top:1px solid var(--rule); color:var(--faint);
  font-size:14px }}
@media (max-width:640px) {{
  main {{ padding:24px 16px 48px }}
  h1 {{ font-size:27px }}
  .lead {{ font-size:16.5px }}
  .wide {{ display:none }}
  .upright {{ display:block; max-width:430px; margin:0 auto }}
  .tiles, .tiles.thirds {{ grid-template-columns:1fr 1fr }}
  .tile {{ padding:12px }}
  .tile b {{ font-size:22px }}
  .charts {{ grid-template-columns:1fr }}
  .card {{ padding:12px }}
  .legend {{ grid-template-columns:1fr }}
  .closeups {{ grid-template-columns:1fr 1fr }}
  .chart text, .chart .tick, .chart .axis-title {{ font-size:15px }}
  th, td {{ padding:6px 8px }}
  .pair td:first-child, .pair td:last-child {{ white-space:normal }}
}}
@media print {{
  body {{ background:#fff; font-size:10pt }}
  h1 {{ font-size:20pt }}
  h2 {{ margin-top:20pt }}
  .tiles, .tiles.thirds {{ grid-template-columns:repeat(auto-fit,minmax(100px,1fr)) }}
  .tile b {{ font-size:15pt }}
  .closeups {{ grid-template-columns:repeat(6,1fr) }}
  .charts {{ grid-template-columns:1fr 1fr }}
  svg.map {{ max-height:12.5cm }}
  table {{ font-size:8.5pt }}
  th, td {{ padding:3pt 5pt; white-space:normal }}
  main {{ max-width:none; padding:0 }}
  .card, .tile, .closeups figure, tr {{ break-inside:avoid }}
  h2 {{ break-after:avoid }}
  .scroll {{ overflow:visible }}
}}
"""
