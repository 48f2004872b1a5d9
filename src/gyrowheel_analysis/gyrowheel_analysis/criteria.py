"""Every statistical threshold of the analysis: its value, unit, reason, and the consequences of a change.

A gain is a decrease of chi-squared, or of minus twice the log likelihood [1]. Numerical constants (grids, steps, limits
of iterations) stand in the module that uses them.
"""

from __future__ import annotations

from typing import Final

# --- effects: selection, ties, plausibility ---

#: Gain for the first amplitude of a term, and for each further one. About forty candidates are tried, on rows whose
#: noise is known to a few percent: lower finds effects in complete models, higher raises all detection limits (root).
ACCEPTED_GAIN: Final = 30.0
ACCEPTED_GAIN_FURTHER: Final = 12.0
#: Loss up to which an alternative counts as a tie: chance exceeds it in one of 1000 cases (chi-squared, two degrees of
#: freedom). Lower hides true alternatives, higher makes clear findings ambiguous.
TIE_LOSS: Final = 14.0
#: Stated uncertainties beyond which a bench parameter is a finding, and from which on it is named as a tie (stated
#: uncertainties are at times too small). Lower blames the bench for missing effects, higher misses wrong benches.
ERROR_LIMIT: Final = 5.0
ERROR_TIE_LIMIT: Final = 3.0
#: Increase of chi-squared in cross-validation that chance explains (two standard deviations of one degree of freedom).
#: Lower removes true effects, higher keeps terms that only describe noise.
CROSS_VALIDATION_LOSS: Final = 4.0
#: Groups of each kind from which on one can be left out; from fewer the rest does not determine the coefficients.
CROSS_VALIDATION_PARTS: Final = {"speed": 3, "azimuth": 3, "recording": 2}
#: Part of the gain of a finding; a rival that is worse by more explains nothing and is not listed.
RIVAL_LOSS: Final = 0.95
#: Standard errors by which an estimate may lie outside of a range by chance (95 %).
MARGIN: Final = 2.0
#: Times the largest usual size, relative errors of a parameter, and stated uncertainties of one that is estimated in
#: the fit, beyond which a value alone is no explanation. Lower calls strong effects unknown, higher lets one effect
#: stand for another one that is missing in the library.
FAR_FROM_USUAL: Final = 5.0
FAR_RELATIVE_ERROR: Final = (-0.5, 1.0)
FAR_FROM_STATED: Final = 5.0
#: Prior standard deviation of an effect that was not found, in usual sizes. Among 3e-3 .. 2e-2 in its square the
#: coverage of 95 % intervals is the same; lower misses look-alikes below their limit, higher widens every interval.
UNDETECTED_SIZE: Final = 0.1
#: Joint standard errors from which on data and prior of a coefficient disagree (one case in 22 by chance). Lower
#: reports chance, higher hides a prior that is wrong by three of its deviations.
PRIOR_CONFLICT: Final = 2.0
#: The same from which on an effect is compared with one that has a free shape: it decides on the time alone.
SHAPE_CONFLICT: Final = 4.0
#: Uncertainties of its source by which a shape must differ for another effect: of windage, between the exponents of
#: laminar and turbulent flow. Lower makes formulas of effects whose source is a little wrong, higher takes what only
#: resembles an effect of the library for it.
ANOTHER_SHAPE: Final = 10.0

# --- free forms ---

#: Gain that a free form needs in addition to or in place of the effects; about 140 forms of 40 kinds are tried.
#: Lower reports unknown physics in noise, higher names the nearest known effect instead.
FORM_GAIN: Final = 30.0
#: The same for a single form that replaces several effects, which has fewer coefficients.
FORM_GAIN_FOR_SEVERAL: Final = 12.0
#: Loss that is accepted for a form that replaces effects that cancel each other: these are no explanation.
FORM_LOSS: Final = 12.0
#: Gain that an effect must bring to be kept next to a form.
BESIDE_FORM_GAIN: Final = 6.0
#: Standard error up to which an exponent is distinguished from the next whole one; standard errors, and distance at any
#: rate, within which it is whole. Wider shows simple laws that are wrong, narrower hides them.
EXPONENT_KNOWN: Final = 0.25
EXPONENT_WITHIN: Final = 2.0
EXPONENT_CLOSE: Final = 0.05

# --- correction map ---

#: Part of the range of a map by which speeds and tilts may exceed it, and temperatures [K] by which those of the coils
#: may: a plan that is run again differs by less. Higher relies on a torque that nobody measured.
MAP_MARGIN: Final = 0.03
MAP_WARMER: Final = 3.0

#: Scale of a drift from which on a map is tried in its place. Lower costs time, higher lets a drift pass for a torque.
DRIFT_OR_MAP: Final = 2.0

#: Least share of what effects of an instant leave that a law with a memory, of usual time constants, must explain
#: before it is tried in full. Lower costs time where events or forms were found, higher misses laws of other time
#: constants.
MEMORY_SHARE: Final = 0.2
#: Least share of its gain that a law with a memory shows along a rough course: two thirds measured for friction of a
#: cable, nearly all for other laws. Lower costs time where nothing is missing, higher misses laws.
MEMORY_ROUGH: Final = 0.6
#: Share of an error that a law with a memory, of usual time constants, must roughly explain before laws of an instant,
#: forms and events are compared with it. It decides on the time alone.
MEMORY_MOST: Final = 0.8
#: Share of the gain of a form that leaves nothing which one law with a memory must reach in its place before all laws
#: with a memory are candidates, and the most that it may lack. A lower share or more costs time, the contrary misses a
#: law if the form also explains what is next to it.
MEMORY_REACH: Final = 0.9
MEMORY_LACKS: Final = 300.0
#: Gain from which on a law with a memory next to which no event or form is found is not compared with those in its
#: place: if it only resembled the truth to 90 %, they would be found in what it leaves. Lower takes events for laws,
#: higher costs time.
MEMORY_ALONE: Final = 300.0
#: Time between windows or samples [s] over which the state of a law is unknown, so that none with a memory is looked
#: for.
MEMORY_PAUSE: Final = 3600.0

# --- events and shapes of drifts ---

#: Gain of an event beyond the largest one by chance among all times. Lower invents events in quiet recordings,
#: higher lets real ones pass for effects.
EVENT_GAIN: Final = 12.0
#: Excess of chi-squared, in its standard deviations, that is left next to events beyond which they are not believed:
#: where that much stays unexplained, a law that is missing looks like steps and bursts. Lower drops events next to a
#: missing law that is small, higher reports events for a large one.
EVENT_LACK: Final = 20.0
#: Gain by which a quantity, kind or time must be better than a simpler one.
EVENT_SIMPLER: Final = 6.0
#: Gain by which an event whose edges all lie on changes of the commanded speed must be better than a law of the motion,
#: which begins and ends there: about one event in twenty does by chance. Lower takes laws for events.
EVENT_COMMANDED: Final = 6.0
#: Laws of the motion that are set apart in the search for events, at most.
MOTION_LAWS: Final = 4
#: Gain within which another quantity explains an event as well; the same odds as `TIE_LOSS`.
EVENT_TIE: Final = 14.0
#: Gain by which the time of an edge may be less likely than the best one; about 3.5 standard errors.
EVENT_LIKELY: Final = 12.0
#: Gain that a kind must bring beyond its number of places: of two that serve equally the simplest is taken.
EVENT_PRICE: Final = {"step": 0.0, "burst": 3.0, "trend": 3.0, "swing": 3.0}
#: Distance [s] within which two searches found the same event, and within which another change may be the same event.
EVENT_SAME: Final = 1.0
EVENT_NEAR: Final = 5.0
#: Standard errors, and at most seconds, around the time by windows within which the samples are searched.
EVENT_SEARCH: Final = 3.0
EVENT_SEARCH_MOST: Final = 5.0
#: Standard errors by which the sizes of a change in two recordings may differ if it stayed.
SAME_SIZE: Final = 4.0
#: Gain in chi-squared from which on the samples show the instant of an event (4 standard deviations).
ONSET_GAIN: Final = 16.0
#: Windows at least before and after a burst; with fewer it is a step.
BURST_BESIDE: Final = 3
#: Shortest trend [s] in the scan (anything shorter looks like a step), and once its ends are refined.
TREND_SHORTEST: Final = 8.0
TREND_SHORTEST_REFINED: Final = 2.0
#: Shortest period [s] and smallest number of periods of a swing: windows of a second and more average out what is
#: faster than the one, and fewer than the other look like a drift.
SWING_FASTEST: Final = 2.0
SWINGS_FEWEST: Final = 1.5
#: Most periods of a swing in a recording: with more, the search would take the square of the length of a recording.
SWINGS_MOST: Final = 200.0
#: Change of a temperature [K] below which nothing can be seen to follow it.
DRIFT_WARMING: Final = 0.3
#: Scale of a drift from which on it counts as enlarged, so that smaller ones are tried with an event.
DRIFT_ENLARGED: Final = 1.05
#: Standard errors by which the scatter of neighbouring windows must exceed the known noise, and the windows that this
#: takes. Lower raises the noise by chance and hides events, higher takes scatter for events.
SCATTER_EXCESS: Final = 2.0
SCATTER_WINDOWS: Final = 8

# --- proof on unseen data ---

#: Standard deviations of chi-squared that chance explains (one case in 700). Lower fails complete models, higher proves
#: incomplete ones.
CHI2_RANGE: Final = 3.0
#: Probability that chance fails a complete model in one of its channels, and that it shows a dependence of one on a
#: variable (after Bonferroni). Higher fails complete models, lower lets a wrong law pass in a channel of few windows.
CHANNEL_CHANCE: Final = 1.0e-3
#: Probability with which the smallest misfit that is stated would have been seen.
CHANNEL_POWER: Final = 0.8
#: Standard error of the variance of the noise [1], all rows alike: the reduction measures deviations to 1.5 %.
NOISE_ERROR: Final = 0.03
#: Gain on unseen data that shows that a finding predicts something (3 standard deviations).
PREDICTING_GAIN: Final = 9.0
#: Variance of a prediction, in noise variances, from which on agreement proves little.
VAGUE_PREDICTION: Final = 0.5
#: Share of a misfit that a cause must account for to be named. Lower names chance, higher names nothing.
CAUSE_SHARE: Final = 0.8
#: Parts, and rows in each, from which on one can be left out and predicted.
PROOF_PARTS: Final = {"recording": 2, "speed": 3, "azimuth": 3, "time": 4}
PROOF_ROWS: Final = 12

#: Decrease of twice the log likelihood of recordings for validation by a finding, from which on it is not offered (3
#: standard deviations). Lower drops true effects, higher offers what only describes the fitted recordings.
WORSE_ELSEWHERE: Final = 9.0

# --- what changed between two sets of recordings ---

#: Probability that chance brings a difference in one of all quantities that are tried, and differences at most.
#: Higher invents changes between equal sets, lower misses small ones.
CHANGED_CHANCE: Final = 1.0e-3
MOST_CHANGES: Final = 6

# --- the next test ---

#: Expected separation that settles a tie (5 standard deviations), and that is worth proposing (3 standard deviations).
SETTLING_SEPARATION: Final = 25.0
USEFUL_SEPARATION: Final = 9.0
#: Factor by which a variation of a plan must separate more than the best plan without variation.
VARIATION_BETTER: Final = 1.5
#: Relative standard error of an effect from which on no further test is needed.
PRECISE: Final = 0.1
#: Part by which a test must reduce an error to be worth its time.
WORTHWHILE: Final = 0.3

# --- error table, comparison, calibration, doubts of an addition ---

#: Noise floors up to which an error counts as noise, and mean square of the whitened residual of a channel from which
#: on a comparison reports a failing model. Lower takes noise for an error (a few windows scatter by 20 %).
NOISE_REACHED: Final = 1.3
FAILING_CHI2: Final = 1.3
#: Standard errors from zero below which an added effect is doubtful, and by which a coefficient of the model rarely
#: moves by chance.
DOUBTFUL: Final = 3.0
MOVED: Final = 4.0
#: Share of a prior uncertainty that is left after the fit, from which on the recordings do not determine a coefficient.
UNCONSTRAINED: Final = 0.9
#: Relative standard error of a calibrated constant from which on it is not determined.
CALIBRATION_ERROR: Final = 0.02
#: Mean square of the whitened residual of the tilt from which on the model lacks something that biases a calibration.
CALIBRATION_CHI2: Final = 2.0

#: Median noises of a channel beyond which the noise of a window is an outlier: it is marked, and sets no axis.
#: Holds and cones of one plan differ by up to this. Lower marks cones, higher lets one window hide all others.
NOISY_WINDOW: Final = 6.0

#: Probability by chance below which measured and simulated torques of the holds of a recording disagree. Higher finds
#: disagreement in right models, lower lets wrong ones pass.
DRAG_CHANCE: Final = 1.0e-3

# --- dependence of a residual on variables, and its law ---

#: Probability by chance (after Bonferroni) below which a dependence, or order in time, is stated.
SIGNIFICANT: Final = 0.01
#: Factor by which noise may be larger than stated before a residual is called more than noise.
NOISE_TRUST: Final = 1.3
#: Share of the sum of squares from which on a variable is named; or share of the part that is neither constant nor in
#: proportion to the tilt. Lower names variables that nobody would see in the map.
DEPENDENCE_SHARE: Final = 0.05
DEPENDENCE_SHARE_LEFT: Final = 0.5
#: Share of the sum of squares from which on a residual is mostly constant or in proportion to the tilt.
MOSTLY_PLAIN: Final = 0.5
#: Difference of Schwarz's criterion within which descriptions are equally good, by which time (which stands for
#: anything that changes) must be better; and one that speaks strongly against the worse (Kass and Raftery, 1995).
EQUAL_DESCRIPTION: Final = 14.0
STRONG_EVIDENCE: Final = 6.0
#: Windows or rows from which on dependence and order are tested.
DEPENDENCE_WINDOWS: Final = 8
#: Excess of chi-squared from which on a law is sought: in standard deviations of noise; for averages, which drift
#: together, in noise variances; and its share of the excess of all parts.
LAW_EXCESS: Final = 6.0
LAW_EXCESS_OF_AVERAGE: Final = 4.0
LAW_SHARE: Final = 0.03
#: Part of the sum of squares by which time, which stands in for all that changes, must describe it better.
LAW_OF_TIME: Final = 0.03
#: Part of the sum of squares that a plainer description may leave.
LAW_PLAINER: Final = 0.01

# --- noise of the rows ---

#: Accuracy of the balance, measured against the full simulation on every shipped plan: part of the torque of the row,
#: and constant part on the default bench [N m], which scales with the torques of a bench. Smaller turns errors of the
#: method into effects, larger raises detection limits.
MODEL_RELATIVE: Final = 5.0e-4
MODEL_ABSOLUTE: Final = 4.0e-6
#: The part for the mean torque of the coils: at most 4e-5 measured, with each effect of an instant at three times its
#: usual size.
MODEL_TILT: Final = 1.0e-4
#: Accuracy of the ripple of the speed while the tilt moves [N m].
MODEL_RIPPLE: Final = 1.0e-4
#: Accuracy of the ripple of the angle: part of it, and constant part [rad].
MODEL_ANGLE: Final = 5.0e-3
ANGLE_FLOOR: Final = 1.0e-6
#: Floor of the variance of the amplitude of a voltage [V²].
VOLTAGE_FLOOR: Final = 1.0e-14
#: Difference between the response of a filter and that of a delay and a pole that are as late, at a phase of one
#: radian; it grows with the cube of the phase. A Butterworth filter of two poles differs from a delay by 0.17.
FILTER_SHAPE: Final = 0.1
#: Range of the scale of a drift: one smaller than stated is not accepted, as few windows may show little by chance.
DRIFT_SCALE_BOUNDS: Final = (1.0, 8.0)
#: Share of an error that terms must explain on the machine that they describe, for noise and rows to be those of that
#: machine. Lower lets a term that stands for something else conceal it, higher keeps the noise of the stated bench.
MACHINE_SHARE: Final = 0.8
#: Part of the largest scale from which on a drift hides a law that is missing, so that events are not believed. Lower
#: drops events in recordings that drift much, higher takes such a law for events.
DRIFT_HIDES: Final = 0.99
#: Prior standard deviation of the logarithm of a drift's scale.
DRIFT_SCALE_SPREAD: Final = 0.7
#: Change of the logarithm of a standard deviation from which on the noise is estimated again.
NOISE_CHANGED: Final = 0.25
#: Chi-squared of the change of the measured rows from which on the torque that noise in the motion needs is subtracted
#: again, for the machine that was found: it alone moves a likelihood by three standard deviations. Higher takes what a
#: late reading leaves of that noise for a misfit, lower costs time.
ROWS_CHANGED: Final = 9.0
#: Stated uncertainties by which the value of a bench parameter in a model file must differ from that of the recordings,
#: and from the stated one, for the file to be wrong: a missing effect of usual size moves no parameter so far, and what
#: was fitted on other recordings of the machine is nearer.
MISSTATED: Final = 10.0
#: Standard uncertainties within which a parameter counts as stated (`Problem.fit_within`).
STATED_RANGE: Final = 3.0
#: Steady windows below which nothing is fitted.
FEWEST_WINDOWS: Final = 6
#: Factor by which two recordings must differ in a distinguishing parameter to be of different machines.
OTHER_MACHINE: Final = 2.0

# --- readings and windows ---

#: Robust standard deviations beyond which a sample is a spike, and the largest share of spikes among the samples.
SPIKE: Final = 8.0
MOST_SPIKES: Final = 0.02
#: Estimated over stated noise of a reading, to which estimates are limited.
NOISE_RANGE: Final = (0.5, 50.0)
#: Mean square of further terms of the polynomials of tilt and angle, over noise, beyond which a motion has not settled.
UNSETTLED_TILT: Final = 10.0
UNSETTLED_ANGLE: Final = 20.0
#: The same, beyond which further terms are used: without them the change from end to end would be off by several times
#: its noise. And beyond which further terms in turn are too few.
FURTHER_TERMS: Final = 2.5
TOO_FEW_TERMS: Final = 4.0
#: Square of the mean residual at an end of a window, over noise, beyond which a motion began or ended there.
EDGE_OF_MOTION: Final = 9.0
#: Residual motor current over noise beyond which averages do not describe it (say, a failing supply).
RESTLESS_CURRENT: Final = 30.0
#: Ratio to its noise at which a harmonic or a spin acceleration counts.
CLEAR_HARMONIC: Final = 10.0
#: Speed change [rad/s²] and distance from the last speed [1] from which on a window of a cone is left out.
CONE_DRIFT: Final = 2.0
CONE_OFF_SPEED: Final = 0.01
#: Share of the steady motion that must be used for the coverage to be complete.
NEARLY_ALL: Final = 0.9
#: Probability that noise is taken for a line of hum, in all frequencies of all channels of a recording.
HUM_CHANCE: Final = 1.0e-7
#: Factor by which the level at a line may exceed the level around it.
HUM_LEVEL: Final = 1.15
#: Standard errors from which on a hum counts, and by which a reading must differ from its statement; of jitter that
#: only the noise of the angle shows. Millions of samples make small errors of the method significant before that.
CLEAR_HUM: Final = 5.0
CLEAR_READING: Final = 5.0
CLEAR_HIDDEN_JITTER: Final = 8.0
#: Robust standard deviations beyond which noise has an outlier (Gaussian noise: one in 2 million), the share of them,
#: their number, and the number of blocks of samples with one, from which on noise is not Gaussian. Lower takes single
#: motions for noise, higher leaves bursts unreported.
OUTLIER: Final = 5.0
OUTLIER_SHARE: Final = 2.0e-4
FEWEST_OUTLIERS: Final = 20
OUTLIER_BLOCKS: Final = 5
#: Outliers that follow each other, on average, from which on they come in bursts.
BURST_OUTLIERS: Final = 3.0
#: Parts of the noise of a reading from which on a hum, a step, a jitter and a hidden jitter count.
HUM_PART: Final = 0.02
STEP_PART: Final = 0.1
JITTER_PART: Final = 0.05
HIDDEN_PART: Final = 0.2
#: Relative error of the rate of the clock, and of the frequency of the mains (which wanders), that counts.
CLOCK_RATE: Final = 1.0e-6
MAINS_FREQUENCY: Final = 5.0e-3
#: Part to which two steps are the same.
SAME_STEP: Final = 1.0e-3
#: Part of a difference of rates to which the reading of the speed must agree to take a side.
RATE_AGREES: Final = 0.2
#: Relative difference of two rates of sampling from which on they are different; part of the changes of a voltage that
#: the recorded tilts explain where every sample is the loop's.
OTHER_RATE: Final = 0.05
ANSWERED: Final = 0.9
#: Probability that anything in a table of many recordings leaves its control limits by chance, and the values that a
#: judgement takes: from fewer, the usual spread is not known. Lower misses small changes, higher names one a table.
TREND_CHANCE: Final = 0.01
TREND_FEWEST: Final = 8
#: Machines from which on it is stated by how much they differ; from two, an interval has ends that differ 70 times.
SPREAD_FEWEST: Final = 3
#: Weight of a new value in the smoothed course of a drift, the usual one of such charts for small changes.
TREND_SMOOTHING: Final = 0.2
