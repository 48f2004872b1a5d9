# %% [markdown]
# # A campaign on a cluster
#
# A campaign draws machines at random, hides an effect in each, and compares the verdicts with the truth. Seed and
# number determine a case, so a cluster changes only the computing time. Here the cluster is this computer; otherwise
# give the address of your scheduler. It needs `pip install 'gyrowheel[dask]'`.

# %%
from dask.distributed import LocalCluster

import gyrowheel as gw

if __name__ == "__main__":  # the workers are processes that may import this file
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        result = gw.campaign("check", cases=2, kinds=["single"], seed=3, dask=cluster.scheduler_address)
    print(result)

# %% [markdown]
# Two cases are an example. An estimate of how often a diagnosis is right needs hundreds: [campaigns](../campaign.md).
