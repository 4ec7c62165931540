"""The public benchmark of discovery: blind cases with a hidden effect, and with none.

`python -m benchmarks.hidden_effects run` works through the cases (and can be interrupted: what is
done is kept), `… table` prints the table. The truth is simulated by `plants`, `laws` and
`simulation`, which import nothing of the product and share no equation text with it; the laws'
shapes differ from the library's on purpose.
"""
