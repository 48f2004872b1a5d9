"""Where a model fails, and how: regions, maps, variables, growth; in figures and in sentences.

The residual is what was measured less what the model asks for, as torques and voltages of coils and motor.
`residuals` has it window by window; of that `regions` names the parts of the data with most of the misfit, `maps` shows
it over the variables, `dependence` tests on which of them it depends, and `growth` says how it goes with the motion.
"""
