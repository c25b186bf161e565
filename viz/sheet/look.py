"""The style sheet of a page: for a screen, and on paper."""

CSS = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 960px; padding: 24px 28px 60px; color: #1a1a1a; background: #fff;
  font: 15px/1.5 "Helvetica Neue", Helvetica, Arial, "Liberation Sans", sans-serif; }
h1 { font-size: 26px; line-height: 1.2; margin: 0 0 4px; }
h2 { font-size: 18px; margin: 34px 0 8px; padding-bottom: 3px; border-bottom: 1px solid #ccc; break-after: avoid; }
h3 { font-size: 15px; margin: 18px 0 4px; break-after: avoid; }
p { margin: 6px 0 10px; }
.lead { color: #555; margin-bottom: 14px; }
.alarm { border-left: 4px solid #b3261e; background: #fbeeed; padding: 8px 12px; margin: 12px 0; }
.note { color: #555; font-size: 13px; }
.answer { display: flex; flex-wrap: wrap; margin: 10px 0 14px; }
.answer div { border: 1px solid #ddd; padding: 6px 14px; margin: 0 8px 8px 0; min-width: 116px; }
.answer b { display: block; font-size: 20px; font-weight: 600; }
.answer span { color: #555; font-size: 12.5px; }
table { border-collapse: collapse; font-size: 13px; margin: 8px 0 12px; font-variant-numeric: tabular-nums; }
th, td { padding: 3px 10px 3px 0; text-align: left; vertical-align: top; }
thead th { border-bottom: 1.5px solid #1a1a1a; font-weight: 600; vertical-align: bottom; }
tbody tr { border-bottom: 1px solid #e3e3e3; break-inside: avoid; }
.numbers td, .numbers th { text-align: right; padding: 3px 0 3px 14px; }
.numbers td:first-child, .numbers th:first-child { text-align: left; padding-left: 0; }
.pairs th { font-weight: 600; padding-right: 18px; white-space: nowrap; }
.pairs td { overflow-wrap: anywhere; }
figure { margin: 10px 0 14px; break-inside: avoid; }
figure img, figure video, figure svg { max-width: 100%; height: auto; display: block; }
figcaption { color: #555; font-size: 12.5px; margin-top: 3px; }
.plot img { max-width: 620px; width: 100%; }
.movie video { max-width: 720px; width: 100%; }
.strip { display: flex; flex-wrap: wrap; }
.strip figure { width: 33%; padding-right: 10px; margin: 4px 0; }
.bars td.bar { width: 320px; padding-top: 7px; }
.bars i { display: block; height: 10px; background: #4477aa; }
pre { background: #f6f6f4; border: 1px solid #e3e3e3; padding: 8px 10px; font: 12px/1.4 Menlo, Consolas, "DejaVu Sans Mono", monospace;
  white-space: pre-wrap; overflow-wrap: anywhere; margin: 6px 0 12px; }
code { font: 12.5px Menlo, Consolas, "DejaVu Sans Mono", monospace; }
summary { cursor: pointer; color: #333; font-weight: 600; font-size: 13.5px; margin: 4px 0; }
@page { size: A4; margin: 16mm 15mm 18mm;
  @bottom-right { content: counter(page) " / " counter(pages); font: 9px sans-serif; color: #777; } }
@media print {
  body { max-width: none; padding: 0; font-size: 10.5px; }
  h1 { font-size: 19px; } h2 { font-size: 14px; margin-top: 20px; } h3 { font-size: 11.5px; }
  table, pre, code, .note, figcaption, summary { font-size: 9px; }
  .answer b { font-size: 14px; } .answer span { font-size: 9px; }
  .movie video { display: none; } .movie figcaption::after { content: " (moves in the HTML page)"; }
  .best img { max-height: 105mm; width: auto; }
  .plot img { max-width: 110mm; }
}
"""
