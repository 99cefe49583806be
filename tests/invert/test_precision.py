"""Networks compute in the precision that the processor has."""

import pytest
import torch

from invert.network.blocks import autocast


@pytest.mark.parametrize("computes_bfloat16", [False, True])
def test_bfloat16_only_where_the_processor_computes_it(monkeypatch, computes_bfloat16):
    """Elsewhere a convolution would take up to 100 times as long; results agree to the precision of bfloat16."""
    monkeypatch.setattr(torch.ops.mkldnn, "_is_mkldnn_bf16_supported", lambda: computes_bfloat16)
    layer, features = torch.nn.Conv2d(3, 5, 3), torch.randn(2, 3, 9, 7, generator=torch.Generator().manual_seed(1))
    with torch.no_grad(), autocast(torch.device("cpu")):
        found = layer(features)
    assert found.dtype == (torch.bfloat16 if computes_bfloat16 else torch.float32)
    torch.testing.assert_close(found.float(), layer(features), atol=0.02, rtol=0.02)
